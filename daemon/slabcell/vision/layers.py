"""Where do slabs of different thickness lie?  Each thickness is looked for in the plane of its own upper faces.

The picture of a thicker slab is larger, and displaced away from the middle of the picture: a slot's slab is compared
and registered at the slot's height.  One thickness, one run of the vision; what the runs say of the same blob is put
together here.  Two slots of one outline and different thickness cannot be told apart from above, and are refused.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import shapely

from slabcell.calibration.model import Calibration
from slabcell.geometry import Points, Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.vision.locate import Locator
from slabcell.vision.placement import SlotPlacement, measure_slots
from slabcell.vision.result import LocatedPart, LocateResult, RejectedBlob, RejectionReason

__all__ = ["Layer", "LayeredLocator"]

# Two outlines are of one blob when they share this much of the smaller.
SAME_SHARE: Final = 0.5
# What says least of a blob: it may well be a slab of another thickness.
_VAGUE: Final = frozenset({RejectionReason.TOO_SMALL, RejectionReason.TOUCHING, RejectionReason.NO_SLOT_FITS})


@dataclass(frozen=True, eq=False)
class Layer:
    """The slots of one thickness: ``slots`` are their numbers, in the order of the locator's own."""

    locator: Locator
    slots: tuple[int, ...]

    def locate(self, image: npt.NDArray[Any], area_mm: Polygon | None, free: Collection[int]) -> LocateResult:
        """Return what lies there of this thickness, with the template's numbers of slots."""
        own = [number for number, slot in enumerate(self.slots) if slot in free]
        return self.renumbered(self.locator.locate(image, area_mm=area_mm, free_slots=own))

    def renumbered(self, found: LocateResult) -> LocateResult:
        """Return a result of the locator with the template's numbers of slots."""
        return replace(
            found,
            parts=tuple(part._replace(slot=self.slots[part.slot]) for part in found.parts),
            empty_slots=tuple(self.slots[slot] for slot in found.empty_slots),
        )


class LayeredLocator:
    """The vision of one calibration and one recipe, whatever its thicknesses are."""

    def __init__(self, calibration: Calibration, recipe: Recipe) -> None:
        self.calibration = calibration
        self.recipe = recipe

    @cached_property
    def layers(self) -> tuple[Layer, ...]:
        """A layer for each thickness, that of most slots first."""
        numbers = range(len(self.recipe.template.slots))
        by_height: dict[float, list[int]] = {}
        for slot in numbers:
            by_height.setdefault(self.recipe.height_mm(slot), []).append(slot)
        if len(by_height) == 1:
            (height,) = by_height
            return (Layer(Locator(self.calibration, _flat(self.recipe, height)), tuple(numbers)),)
        ordered = sorted(by_height.items(), key=lambda item: -len(item[1]))
        return tuple(
            Layer(Locator(self.calibration, _part_of(self.recipe, height, slots)), tuple(slots))
            for height, slots in ordered
        )

    @cached_property
    def _whole(self) -> dict[float, Locator]:
        """For each thickness the whole template at that height."""
        heights = {self.recipe.height_mm(slot) for slot in range(len(self.recipe.template.slots))}
        return {height: Locator(self.calibration, _flat(self.recipe, height)) for height in heights}

    def open_model(self) -> None:
        """Open the recipe's promptable model, if it names one.  Raises ModelError."""
        for layer in self.layers:
            _ = layer.locator.segmenter

    def locate(
        self,
        image: npt.NDArray[Any],
        *,
        area_mm: Polygon | None = None,
        free_slots: Collection[int] | None = None,
    ) -> LocateResult:
        """Return what `slabcell.vision.locate` returns.

        With several thicknesses the features of blobs are those in the plane of the first layer, and only its parts
        and refusals name their blob.
        """
        if len(self.layers) == 1:
            return self.layers[0].locator.locate(image, area_mm=area_mm, free_slots=free_slots)
        free = set(range(len(self.recipe.template.slots))) if free_slots is None else set(free_slots)
        return self.merged([layer.locate(image, area_mm, free) for layer in self.layers], free)

    def merged(self, results: list[LocateResult], free: Collection[int]) -> LocateResult:
        """Return what the layers say together; ``results`` are in their order."""
        first = results[0]
        found = [part if result is first else part._replace(blob=None) for result in results for part in result.parts]
        kept, unsure = _told_apart(found, self.recipe)
        shapes = [_shape(part.outline_px) for part in found]
        refused = [*unsure]
        for result in results:
            for blob in result.rejected:
                here = shapely.Point(blob.u, blob.v)
                if any(shape.contains(here) for shape in shapes):
                    continue  # another layer knows what it is
                refused = _joined(refused, blob if result is first else _without_blob(blob))
        times: dict[str, float] = {}
        for result in results:
            for stage, duration_ms in result.timing_ms.items():
                times[stage] = times.get(stage, 0.0) + duration_ms
        filled = {part.slot for part in kept}
        return replace(
            first,
            parts=tuple(sorted(kept, key=lambda part: part.slot)),
            rejected=tuple(refused),
            empty_slots=tuple(sorted(set(free) - filled)),
            timing_ms=times,
        )

    def measure(
        self, image: npt.NDArray[Any], *, assembly_in_table: RigidTransform2D, slots: Collection[int]
    ) -> tuple[SlotPlacement, ...]:
        """Return how the slabs lie in these slots, as `measure_slots` does, each at its own height.

        Joints between slabs of different thickness are steps, which tell no place: they are left out.
        """
        found: list[SlotPlacement] = []
        for height, locator in self._whole.items():
            own = [slot for slot in slots if self.recipe.height_mm(slot) == height]
            if own:
                found += measure_slots(locator, image, assembly_in_table=assembly_in_table, slots=own)
        return tuple(sorted(found, key=lambda item: item.slot))


def _flat(recipe: Recipe, height_mm: float) -> Recipe:
    return replace(recipe, thickness_mm=height_mm, other_thickness_mm={})


def _part_of(recipe: Recipe, height_mm: float, slots: Collection[int]) -> Recipe:
    """Return a recipe with these slots only; forbidden zones of the grasp follow their slots."""
    numbers = {slot: number for number, slot in enumerate(slots)}
    zones = [
        zone if zone.slot is None else zone.model_copy(update={"slot": numbers[zone.slot]})
        for zone in recipe.grasp.forbidden
        if zone.slot is None or zone.slot in numbers
    ]
    return replace(
        _flat(recipe, height_mm),
        template=replace(recipe.template, slots=tuple(recipe.template.slots[slot] for slot in slots)),
        grasp=recipe.grasp.model_copy(update={"forbidden": zones}),
    )


def _without_blob(blob: RejectedBlob) -> RejectedBlob:
    return RejectedBlob(blob.u, blob.v, blob.area_mm2, blob.reason, blob.detail, blob.outline_px)


def _told_apart(found: list[LocatedPart], recipe: Recipe) -> tuple[list[LocatedPart], list[RejectedBlob]]:
    """Return the parts that are what they are, and those that may as well be of another thickness."""
    lead_mm = recipe.matching.min_lead_mm
    shapes = [_shape(part.outline_px) for part in found]
    kept: list[LocatedPart] = []
    unsure: list[RejectedBlob] = []
    for number, part in enumerate(found):
        rivals = [
            other
            for index, other in enumerate(found)
            if index != number and _overlap(shapes[number], shapes[index]) > SAME_SHARE
        ]
        if any(other.residual_mm <= part.residual_mm - lead_mm for other in rivals):
            continue  # the other one is kept
        alike = [other for other in rivals if other.residual_mm < part.residual_mm + lead_mm]
        if not alike:
            kept.append(part)
            continue
        slots = ", ".join(str(other.slot) for other in alike)
        detail = f"fits slot {part.slot}, and slot {slots} of another thickness as well: not told apart from above"
        area_mm2 = recipe.template.slots[part.slot].area_mm2
        place = part.image.u, part.image.v
        refusal = RejectedBlob(*place, area_mm2, RejectionReason.UNSURE, detail, part.outline_px, part.blob)
        unsure = _joined(unsure, refusal)
    return kept, unsure


def _joined(refused: list[RejectedBlob], blob: RejectedBlob) -> list[RejectedBlob]:
    """Add what one layer says of a blob, unless another has said something that tells more."""
    shape = _shape(blob.outline_px)
    for index, known in enumerate(refused):
        if _overlap(shape, _shape(known.outline_px)) > SAME_SHARE:
            if known.reason in _VAGUE and blob.reason not in _VAGUE:
                return [*refused[:index], replace(blob, blob=known.blob), *refused[index + 1 :]]
            return refused
    return [*refused, blob]


def _overlap(one: shapely.Polygon, other: shapely.Polygon) -> float:
    smaller = min(one.area, other.area)
    return shapely.intersection(one, other).area / smaller if smaller > 0.0 else 0.0


def _shape(outline: Points) -> shapely.Polygon:
    if len(outline) < 3:
        return shapely.Polygon()
    shape = shapely.Polygon(np.asarray(outline, np.float64))
    return shape if shape.is_valid else shapely.convex_hull(shape)  # pyright: ignore[reportReturnType]  (of a polygon)
