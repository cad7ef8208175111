"""Which of a promptable model's masks are slabs?  Those with a slot's area and inertia, firm, and not one in another.

The model's own score says how crisp a mask is, not whether it is a slab: the table, a shadow and half a slab are crisp
too.  So the score is not used.  What decides is the shape in millimetres against the template's, how firm the mask is
when its threshold moves, and of masks that overlap, whose outline a slot fits best.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from slabcell.recipe import PromptableParameters
from slabcell.vision.blobs import Blobs, RawBlob, find_blobs
from slabcell.vision.describe import describe_blobs
from slabcell.vision.kernel import engine
from slabcell.vision.matching import MatchLimits
from slabcell.vision.prepared import Prepared
from slabcell.vision.promptable.model import Logits

__all__ = ["Selection", "outline_of", "select"]

# The area on the model's grid may be off by this factor before the outline is looked at: perspective, and coarse cells.
ROUGH: Final = 2.0
# Cells kept around a mask when it is drawn at full size.
AROUND: Final = 2
# Outlines differ by up to this share of the slot's size when they are compared.
OUTLINE_SHARE: Final = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class _Mask:
    blob: RawBlob
    stability: float


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The blobs that are slabs as far as masks can tell, and how many masks were left out for what."""

    blobs: list[RawBlob]
    shapes: list[Any]
    wrong: int
    unstable: int
    repeated: int


def select(
    found: Sequence[Logits], prepared: Prepared, size: tuple[int, int], parameters: PromptableParameters
) -> Selection:
    """Return which masks are slabs; ``size``: height and width of the picture."""
    scale = prepared.plane.mm_per_px**2
    areas = prepared.shapes.area_mm2
    least = float(areas.min()) * (1.0 - parameters.area_tolerance) / scale / ROUGH
    most = float(areas.max()) * (1.0 + parameters.area_tolerance) / scale * ROUGH
    masks: list[_Mask] = []
    wrong = unstable = 0
    for logits in found:
        for values in logits.values:
            area = float(np.count_nonzero(values > 0.0)) / (logits.per_u * logits.per_v)
            mask = _draw(values, logits, size, parameters.stability_margin) if least <= area <= most else None
            if mask is None:
                wrong += 1
            elif mask.stability < parameters.min_stability:
                unstable += 1
            else:
                masks.append(mask)
    kept, distances = _of_a_slot(masks, prepared, parameters)
    wrong += len(masks) - len(kept)
    order = sorted(range(len(kept)), key=lambda index: (distances[index], -kept[index].stability))
    blobs: list[RawBlob] = []
    shapes: list[Any] = []
    for index in order:
        shape = outline_of(kept[index].blob)
        if not any(_overlap(shape, other) > parameters.max_overlap for other in shapes):
            blobs.append(kept[index].blob)
            shapes.append(shape)
    return Selection(blobs, shapes, wrong, unstable, len(kept) - len(blobs))


def _draw(values: npt.NDArray[np.float32], logits: Logits, size: tuple[int, int], margin: float) -> _Mask | None:
    """Return the largest region of a mask at the picture's own size, or None where there is none."""
    rows, columns = np.nonzero(values > -margin)
    height, width = size
    left = max(int((columns.min() - AROUND) / logits.per_u), 0)
    top = max(int((rows.min() - AROUND) / logits.per_v), 0)
    right = min(int((columns.max() + 1 + AROUND) / logits.per_u) + 1, width)
    bottom = min(int((rows.max() + 1 + AROUND) / logits.per_v) + 1, height)
    if right <= left or bottom <= top:
        return None
    place = np.array(
        [
            [logits.per_u, 0.0, (left + 0.5) * logits.per_u - 0.5],
            [0.0, logits.per_v, (top + 0.5) * logits.per_v - 0.5],
        ]
    )
    smooth = cv2.warpAffine(
        values,
        place,
        (right - left, bottom - top),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    regions, _ = find_blobs((smooth > 0.0).astype(np.uint8) * np.uint8(255), 4.0)
    if not regions:
        return None
    firm, loose = int(np.count_nonzero(smooth > margin)), int(np.count_nonzero(smooth > -margin))
    polygon = regions[0].polygon + np.array([left, top], np.float64)
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    rim = bool(low.min() <= 0 or high[0] >= width - 1 or high[1] >= height - 1)
    return _Mask(RawBlob(polygon, regions[0].area_px, rim), firm / max(loose, 1))


def _of_a_slot(
    masks: Sequence[_Mask], prepared: Prepared, parameters: PromptableParameters
) -> tuple[list[_Mask], list[float]]:
    """Return the masks with area and inertia of a slot, and how far each outline is from the nearest slot's, in mm."""
    if not masks:
        return [], []
    shapes = describe_blobs(Blobs.of([mask.blob for mask in masks]), prepared.plane, without_walls=prepared.walls)
    slots = prepared.shapes
    with np.errstate(divide="ignore", invalid="ignore"):
        area = np.abs(np.log(shapes.area_mm2[:, None] / slots.area_mm2))
        inertia = np.abs(np.log(shapes.inertia[:, None] / slots.inertia))
    alike = (area <= np.log1p(parameters.area_tolerance)) & (inertia <= np.log1p(parameters.inertia_tolerance))
    best = np.full(len(masks), np.inf)
    limits = MatchLimits(
        distance_mm=OUTLINE_SHARE * np.sqrt(slots.area_mm2),
        symmetry_order=prepared.orders,
        margin_mm=0.0,
        floor_mm=0.1 * prepared.plane.mm_per_px,
        area=parameters.area_tolerance,
    )
    for item in engine().find_candidates(shapes, slots, limits, alike):
        best[item.blob] = min(best[item.blob], item.distance_mm)
    numbers = np.flatnonzero(alike.any(axis=1)).tolist()
    return [masks[index] for index in numbers], [float(best[index]) for index in numbers]


def outline_of(blob: RawBlob) -> Any:
    """Return a blob as a shapely polygon in pixels; an outline that touches itself is mended."""
    if len(blob.polygon) < 3:
        return shapely.Point(blob.polygon[0]).buffer(0.5)
    shape = shapely.Polygon(blob.polygon)
    return shape if shape.is_valid else shape.buffer(0)


def _overlap(first: Any, second: Any) -> float:
    """Return which share of the smaller of two shapes the other one covers."""
    smaller = min(float(first.area), float(second.area))
    return float(first.intersection(second).area) / smaller if smaller > 0.0 else 1.0
