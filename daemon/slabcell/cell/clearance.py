"""Does the gripper hit what is higher than the slab that it holds?  Slabs of several thicknesses beside each other.

The gripper's underside is where the slab's upper face is.  A slab that is higher, and reaches under the gripper, is in
its way: where a part is picked it has to be gone first, and where it is laid it must not lie yet.  With slabs of one
thickness nothing of this can happen, and nothing is computed.  What is no located part has a height that nobody knows.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

import shapely

from slabcell.catalogue import Fault
from slabcell.cell.settings import CellSettings
from slabcell.cell.workspace import Refusal
from slabcell.recipe import Recipe
from slabcell.vision.grasp import choose_grasp
from slabcell.vision.result import LocatedPart

__all__ = ["Clearance", "Precedence"]

SAME_MM: Final = 0.5
"""Heights that differ by less than this count as one."""
MARGIN_MM: Final = 1.0
"""Kept between gripper and higher slabs, to the side."""


@dataclass(frozen=True, slots=True)
class Precedence:
    """What has to be laid before each slot's slab (``after``), and parts for which there is no way at all."""

    after: Mapping[int, frozenset[int]]
    refused: tuple[Refusal, ...]


class Clearance:
    """The heights of one recipe in one cell; what does not change from picture to picture is computed once."""

    def __init__(self, recipe: Recipe, settings: CellSettings) -> None:
        self._slots = recipe.template.slots
        self._heights = [recipe.height_mm(slot) for slot in range(len(self._slots))]
        self._reach_mm = settings.gripper_radius_mm + MARGIN_MM
        self._approach_mm = settings.approach_mm
        self.one_height = max(self._heights) - min(self._heights) <= SAME_MM
        self._beside: dict[int, frozenset[int]] = {}
        """For each slot the higher ones that the gripper would hit where the slab is laid."""
        if self.one_height:
            return
        for number, slot in enumerate(self._slots):
            point = choose_grasp(slot, recipe.grasp, number).point
            if point is not None:
                outlines = {other: polygon.shape for other, polygon in enumerate(self._slots)}
                self._beside[number] = self._hit(number, (float(point[0]), float(point[1])), outlines)

    def too_high(self) -> str:
        """Return why slabs cannot be carried over what lies: the approach is lower than it; empty if they can."""
        highest = max(self._heights)
        if self.one_height or self._approach_mm > highest:
            return ""
        slot = self._heights.index(highest)
        return (
            f"the approach of {self._approach_mm:g} mm is not above the slab of slot {slot}, {highest:g} mm high:"
            " raise robot.krl.approach_mm"
        )

    def precedence(self, parts: Mapping[int, LocatedPart], laid: Collection[int]) -> Precedence:
        """Return what must come before what, for located parts by slot, when the slots ``laid`` are filled."""
        if self.one_height:
            return Precedence({}, ())
        after = {slot: {low for low in parts if slot in self._beside.get(low, ())} for slot in parts}
        refused: list[Refusal] = []
        outlines = {
            slot: self._slots[slot].transformed(part.table_to_assembly.inverse()).shape for slot, part in parts.items()
        }
        for slot, part in parts.items():
            after[slot] |= self._hit(slot, (part.pick.x_mm, part.pick.y_mm), outlines)
            there = sorted(self._beside.get(slot, frozenset()) & set(laid))
            waits = sorted(low for low, high in self._beside.items() if slot in high and low not in {*laid, *parts})
            if there:
                detail = f"the gripper would hit the slab in slot {there[0]}, which is higher and lies there already"
                refused.append(Refusal(slot, Fault.COLLISION, detail))
            elif waits:
                detail = f"slot {waits[0]} beside it is lower and not filled: the gripper could not reach it later"
                refused.append(Refusal(slot, Fault.COLLISION, detail))
        return Precedence({slot: frozenset(before) for slot, before in after.items()}, tuple(refused))

    def _hit(self, slot: int, at: tuple[float, float], outlines: Mapping[int, shapely.Polygon]) -> frozenset[int]:
        """Return whose slabs are higher than that of ``slot`` and within reach of a gripper at this point."""
        point, height = shapely.Point(at), self._heights[slot] + SAME_MM
        higher = (other for other in outlines if self._heights[other] > height)
        return frozenset(other for other in higher if outlines[other].distance(point) < self._reach_mm)
