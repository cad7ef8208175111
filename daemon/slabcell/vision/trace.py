"""What happened inside of the vision on its way through a picture?  For a person who tunes a recipe.

`trace` runs the vision as it is, and keeps what it passes by: the mask, the outlines of blobs, and how far from each
located slab's outline its edges were measured.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError
from slabcell.geometry import Points, Polygon
from slabcell.vision.blobs import Blobs, RawBlob
from slabcell.vision.edge_projection import Outlines, Poses
from slabcell.vision.kernel import engine
from slabcell.vision.layers import LayeredLocator
from slabcell.vision.local_map import MARGIN_PX
from slabcell.vision.locate import Locator
from slabcell.vision.picture_model import picture_model
from slabcell.vision.pixels import Grey, as_grey
from slabcell.vision.result import LocatedPart, LocateResult
from slabcell.vision.segmentation import Segmentation

__all__ = ["EdgeResiduals", "Trace", "trace"]


@dataclass(frozen=True, slots=True, eq=False)
class EdgeResiduals:
    """How well one slab's edges agree with the outline that was fitted to them; arrays over pieces of the outline.

    ``pixels`` (n, 2): where the outline runs in the picture; ``outward_mm`` (n,): how far outward of it the edge was
    measured; ``valid`` (n,): whether an edge was found there at all.
    """

    slot: int
    pixels: Points
    outward_mm: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """One run of the vision.  ``refusal`` says why there is no result, as far as it got; empty if there is one.

    ``mask`` (h, w) uint8: 255 on what was taken for slabs.
    """

    result: LocateResult | None
    refusal: str
    segmentation: str
    mask: npt.NDArray[np.uint8] | None
    blobs: tuple[RawBlob, ...]
    residuals: tuple[EdgeResiduals, ...]


def trace(
    locator: LayeredLocator,
    image: npt.NDArray[Any],
    *,
    area_mm: Polygon | None = None,
    free_slots: Collection[int] | None = None,
) -> Trace:
    """Return what the vision made of a picture, and how.

    A picture that the gates refuse is a trace with a refusal.  Raises CalibrationError for a picture of another size
    than the calibration's.
    """
    seen: list[tuple[Segmentation, Blobs]] = []
    results: list[LocateResult] = []
    residuals: list[EdgeResiduals] = []
    free = set(range(len(locator.recipe.template.slots))) if free_slots is None else set(free_slots)
    refusal = ""

    def watch(segmentation: Segmentation, blobs: Blobs) -> None:
        seen.append((segmentation, blobs))

    try:
        for layer in locator.layers:
            own = [number for number, slot in enumerate(layer.slots) if slot in free]
            found = layer.locator.locate(image, area_mm=area_mm, free_slots=own, watch=watch)
            results.append(layer.renumbered(found))
            if found.parts:
                measured = _residuals(layer.locator, as_grey(image), found.parts)
                residuals += [replace(item, slot=layer.slots[item.slot]) for item in measured]
    except ImageError as error:
        refusal = str(error)
    segmentation, blobs = seen[0] if seen else (None, ())
    result = None if refusal else results[0] if len(results) == 1 else locator.merged(results, free)
    located = set[int]() if result is None else {part.slot for part in result.parts}
    return Trace(
        result,
        refusal,
        segmentation.description if segmentation else "",
        segmentation.mask if segmentation else None,
        tuple(blobs),
        tuple(item for item in residuals if item.slot in located),
    )


def _residuals(locator: Locator, grey: Grey, parts: Sequence[LocatedPart]) -> tuple[EdgeResiduals, ...]:
    """Measure the edges of located slabs once more, where they were found to lie."""
    plane, outlines = locator.plane, locator.outlines
    slots = [part.slot for part in parts]
    motions = [part.table_to_assembly.inverse() for part in parts]
    pivots = outlines.pivots[slots]
    position = np.array([motion.apply(pivot) for motion, pivot in zip(motions, pivots, strict=True)])
    turns = np.array([math.radians(motion.rotation_deg) for motion in motions])
    poses = Poses(turns, position, pivots, np.array([part.kerf_mm for part in parts]))
    pieces = [outlines.pieces[slot] for slot in slots]
    maps = engine().map_locally(plane, position, outlines.reaches_mm[slots] + MARGIN_PX * plane.mm_per_px)
    model, _ = picture_model(grey, plane, pieces, maps, poses, rough=False)
    whole = Outlines.of(pieces)
    edges = engine().project(whole, maps, poses, mirrored=plane.mirrored)
    shifts = engine().measure_edges(grey, edges.lines, model)
    outward_mm = shifts.shift / edges.px_per_mm
    return tuple(
        EdgeResiduals(slot, edges.lines.middle[begin:end], outward_mm[begin:end], shifts.valid[begin:end])
        for slot, begin, end in zip(slots, whole.starts[:-1], whole.starts[1:], strict=True)
    )
