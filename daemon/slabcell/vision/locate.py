"""Where do the slabs lie, and which slot is each for?  The stages in order: segment, blobs, match, register, grasp."""

import bisect
import itertools
import math
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import shapely

from slabcell.calibration.model import Calibration
from slabcell.geometry import Polygon
from slabcell.recipe import Recipe
from slabcell.vision.blob_report import report_blobs
from slabcell.vision.blobs import Blobs, RawBlob
from slabcell.vision.describe import describe_blobs
from slabcell.vision.gates import blur_gate, light_gates, reference_gates, require
from slabcell.vision.kernel import engine
from slabcell.vision.morphology import net_erosion_px
from slabcell.vision.outcome import Outcome
from slabcell.vision.outline import Rings
from slabcell.vision.pixels import Grey, as_8_bit, as_grey
from slabcell.vision.plane import GRID_PX
from slabcell.vision.prepared import Prepared
from slabcell.vision.result import LocateResult
from slabcell.vision.segmentation import Segmentation, segment
from slabcell.vision.survey import Survey

if TYPE_CHECKING:
    from slabcell.vision.promptable.segmenter import PromptableSegmenter

__all__ = ["Locator", "locate"]


def locate(
    image: npt.NDArray[Any],
    calibration: Calibration,
    recipe: Recipe,
    *,
    area_mm: Polygon | None = None,
    free_slots: Collection[int] | None = None,
) -> LocateResult:
    """Return the slabs found in a picture, each with its slot and poses, and everything refused with the reason.

    ``image``: (h, w) or (h, w, 3) blue green red, uint8 or uint16.  ``area_mm``: only blobs whose middle lies in
    this polygon of the table count.  ``free_slots``: only these may be filled; None means all.  Raises
    CalibrationError for a picture of another size than the calibration's, ImageError for an array that is no picture
    and for a picture that the recipe's gates refuse.

    For several pictures of one product make a `Locator` once.
    """
    return Locator(calibration, recipe).locate(image, area_mm=area_mm, free_slots=free_slots)


class Locator(Prepared):
    """Everything about a calibration and a recipe that does not change from picture to picture, and what uses it."""

    def locate(
        self,
        image: npt.NDArray[Any],
        *,
        area_mm: Polygon | None = None,
        free_slots: Collection[int] | None = None,
        watch: Callable[[Segmentation, Blobs], None] | None = None,
    ) -> LocateResult:
        """Return what `locate` returns; ``watch`` is shown segmentation and blobs before anything is matched."""
        clock = _Clock()
        grey = as_grey(image)
        self.calibration.require_size(grey.shape[1], grey.shape[0], "the picture")
        free = set(range(len(self.slots))) if free_slots is None else set(free_slots)
        surveyed = engine().survey(as_8_bit(grey))
        gates = light_gates(grey, surveyed, self.recipe.gates)
        if self.recipe.gates.marks or self.recipe.gates.rim_mm is not None:
            gates += reference_gates(grey, self.table, self.recipe.gates)
        require(gates)
        segmentation, blobs, left_out = self._blobs(grey, image, surveyed)
        if self.segmenter is not None:
            segmentation, blobs = self.segmenter.segment(image, segmentation, blobs, self)
        if watch is not None:
            watch(segmentation, blobs)
        gates += blur_gate(surveyed, segmentation.contrast, self.recipe.gates)
        require(gates)
        clock.stop("segment")
        if area_mm is not None:
            blobs = self._inside(blobs, area_mm)
        described = describe_blobs(blobs, self.plane, without_walls=self.walls)
        report = None
        if self.recipe.blobs.used:
            report = report_blobs(blobs, grey, segmentation.mask, self.plane, self.recipe.blobs)
        clock.stop("blobs")
        outcome = Outcome(self, blobs, described, free, None if report is None else report.filtered)
        candidates = outcome.candidates()
        clock.stop("match")
        registrations = engine().register(grey, self.plane, self.outlines, candidates, rough=self.walls)
        parted, found = outcome.split_touching(grey, segmentation)
        candidates, registrations = candidates + parted, registrations + found
        clock.stop("register")
        parts, rejected = outcome.decide(candidates, registrations)
        features = None
        if report is not None:
            features, parts, rejected = report.arrange(parts, rejected)
        clock.stop("decide")
        filled = {part.slot for part in parts}
        specks = f"{left_out} specks left out" if left_out else ""
        return LocateResult(
            tuple(parts),
            tuple(rejected),
            tuple(sorted(free - filled)),
            clock.times(),
            "; ".join(filter(None, (segmentation.description, specks))),
            engine().name,
            gates,
            features,
        )

    @cached_property
    def segmenter(self) -> "PromptableSegmenter | None":
        """The promptable model of the recipe, opened when first asked for.  Raises ModelError."""
        parameters = self.recipe.segmentation
        if parameters.method != "promptable" or parameters.promptable is None:
            return None
        # Only a recipe that uses a model pays for importing what runs it.
        from slabcell.vision.promptable.segmenter import PromptableSegmenter  # noqa: PLC0415

        return PromptableSegmenter(parameters.promptable)

    def _blobs(self, grey: Grey, image: npt.NDArray[Any], surveyed: Survey) -> tuple[Segmentation, Blobs, int]:
        """Return segmentation, blobs and how many were left out.

        What is automatic is tried in another way where no blob has the size of a slot: a light floor around a dark
        table, say, makes the table look like a dark slab.
        """
        parameters = self.recipe.segmentation
        if parameters.promptable is not None and parameters.method == "promptable":
            parameters = parameters.model_copy(update={"method": parameters.promptable.coarse})
        min_area_px = parameters.min_area_mm2 / self.plane.mm_per_px**2
        first = self._seen(segment(grey, parameters, image, surveyed=surveyed))
        blobs, left_out = self._found(first, min_area_px)
        if not blobs or self._any_plausible(blobs):
            return first, blobs, left_out
        best, best_count = (first, blobs, left_out), 0
        for method, polarity in itertools.product(("auto", "local", "multi_otsu"), ("light", "dark")):
            if (parameters.method != "auto" and method != "auto") or parameters.polarity not in ("auto", polarity):
                continue
            kept = parameters.method if method == "auto" else method
            changed = parameters.model_copy(update={"method": kept, "polarity": polarity})
            other = self._seen(segment(grey, changed, image, surveyed=surveyed))
            found, dropped = self._found(other, min_area_px)
            count = sum(1 for _ in self._plausible(found))
            if count > best_count:
                note = f"{other.description}, tried because no blob of '{first.description}' has the size of a slot"
                best, best_count = (replace(other, description=note), found, dropped), count
        return best

    def _found(self, segmentation: Segmentation, min_area_px: float) -> tuple[Blobs, int]:
        """Return the blobs, and how many were left out.

        Outlines are put back by what the recipe's steps have eroded, so that blobs may be parted by eroding them.
        """
        blobs, left_out = segmentation.blobs(min_area_px, self.row_shift)
        eroded = net_erosion_px(self.recipe.segmentation.morphology)
        if not blobs or eroded == 0.0:
            return blobs, left_out
        rings = Rings.of([blob.polygon for blob in blobs]).counter_clockwise()
        grown = rings.offset_outward(eroded)
        ends = zip(rings.starts[:-1], rings.starts[1:], np.abs(grown.moments[0] - rings.moments[0]), strict=True)
        blobs = [
            RawBlob(grown.points[begin:end], blob.area_px + math.copysign(float(strip), eroded), blob.touches_rim)
            for blob, (begin, end, strip) in zip(blobs, ends, strict=True)
        ]
        return Blobs.of(blobs), left_out

    def _seen(self, segmentation: Segmentation) -> Segmentation:
        """Return the segmentation without what lies where the picture sees no table."""
        usable = self.plane.usable
        if usable is None:
            return segmentation
        height, width = segmentation.mask.shape
        whole = np.repeat(np.repeat(usable, GRID_PX, axis=0), GRID_PX, axis=1)[:height, :width]
        share = 100.0 * (1.0 - float(whole.mean()))
        note = f"{share:.0f} % of the picture see no table"
        made = np.where(whole, segmentation.mask, np.uint8(0))
        return replace(segmentation, level=None, made=made, description=f"{segmentation.description}; {note}")

    def _any_plausible(self, blobs: Blobs) -> bool:
        """Return whether some blob has about the area of a slot and lies wholly in the picture."""
        return next(self._plausible(blobs), None) is not None

    def _plausible(self, blobs: Blobs) -> Iterator[int]:
        """Yield the blobs that have about the area of a slot and lie wholly in the picture."""
        factor = 1.0 + 2.0 * self.recipe.matching.area_tolerance
        sizes, scale = self.sorted_areas_mm2, self.plane.mm_per_px**2
        for index, (area, rim) in enumerate(zip(blobs.area_px, blobs.touches_rim, strict=True)):
            # The smallest slot that is not smaller than this blob could be.
            nearest = bisect.bisect_left(sizes, area * scale / factor)
            if not rim and nearest < len(sizes) and sizes[nearest] <= area * scale * factor:
                yield index

    def _inside(self, blobs: Blobs, area_mm: Polygon) -> Blobs:
        if not blobs:
            return blobs
        middles = engine().to_plane(self.plane.grid, np.array([blob.polygon.mean(axis=0) for blob in blobs]))
        inside = shapely.contains_xy(area_mm.shape, middles[:, 0], middles[:, 1])
        return Blobs.of([blob for blob, keep in zip(blobs, inside, strict=True) if keep])


class _Clock:
    def __init__(self) -> None:
        self._begin = self._last = time.perf_counter()
        self._times: dict[str, float] = {}

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self._times[stage] = 1e3 * (now - self._last)
        self._last = now

    def times(self) -> dict[str, float]:
        return {**self._times, "total": 1e3 * (self._last - self._begin)}
