"""Is the best explanation of a blob sure?  Not where another slot or another rotation explains it about as well.

Two explanations are told apart by how much worse the second one fits what is seen: the root of the difference of the
squared RMS distances is the RMS distance between what both expect, as far as the picture supports it.  Slots of the
same outline are no doubt, and neither are rotations that look alike: they come to the same.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.vision.matching import assign
from slabcell.vision.outline import distance_to_outline

__all__ = ["Explanation", "doubts", "kinds_of"]

# Rotations that differ by less are one.
SAME_TURN_DEG: Final = 3.0
# What the best explanation leaves over may hide the difference to another: the lead must be this share of it.
SHARE_OF_RESIDUAL: Final = 0.5


class Explanation(NamedTuple):
    """A blob as the slab of a slot, turned by ``rotation_deg``; ``evidence_mm``: RMS distance to what is seen."""

    blob: int
    slot: int
    rotation_deg: float
    evidence_mm: float


def doubts(
    explanations: Sequence[Explanation],
    assigned: Mapping[int, int],
    *,
    kinds: Sequence[int],
    orders: Sequence[int],
    free: Collection[int],
    min_lead_mm: float,
) -> dict[int, str]:
    """Return for each blob whose slot or rotation is not sure why.

    ``explanations``: all that pass the limits.  ``assigned``: the slot of each blob.  ``kinds``: slots with the same
    number have the same outline.  ``orders``: rotations of each slot that look alike.  ``free``: slots that may be
    filled.
    """
    of_blob: dict[int, list[Explanation]] = {}
    for item in explanations:
        of_blob.setdefault(item.blob, []).append(item)
    square: dict[tuple[int, int], float] = {}
    for item in explanations:
        key = (item.blob, item.slot)
        square[key] = min(item.evidence_mm**2, square.get(key, np.inf))
    alternatives = _Alternatives(square, assigned, kinds, free)
    found: dict[int, str] = {}
    for blob, slot in assigned.items():
        if len(of_blob.get(blob, [])) < 2 or (blob, slot) not in square:
            continue
        first = min((item for item in of_blob[blob] if item.slot == slot), key=lambda item: item.evidence_mm)
        needed = max(min_lead_mm, SHARE_OF_RESIDUAL * first.evidence_mm)
        leads = [
            (item.evidence_mm**2 - first.evidence_mm**2, f"lies in slot {slot} as it is or turned by {turned:.0f}°")
            for item in of_blob[blob]
            if item.slot == slot and (turned := _turn(first, item, orders[slot])) > SAME_TURN_DEG
        ]
        leads += [(lead, f"fits slot {slot} and slot {other}") for other, lead in alternatives.of(blob)]
        if not leads:
            continue
        lead, what = min(leads)
        apart = float(np.sqrt(max(lead, 0.0)))
        if apart < needed:
            found[blob] = f"{what} alike: {apart:.3f} mm tell them apart, {needed:.3f} mm are needed"
    return found


@dataclass(frozen=True, eq=False)
class _Alternatives:
    """Other ways to give all blobs of ``assigned`` a slot.  ``square``: mean square distance of blob and slot."""

    square: Mapping[tuple[int, int], float]
    assigned: Mapping[int, int]
    kinds: Sequence[int]
    free: Collection[int]

    def of(self, blob: int) -> list[tuple[int, float]]:
        """Return each slot of another outline that this blob may have instead, and what it costs all of them."""
        own = self.assigned[blob]
        others = [slot for slot in self._choices[blob] if self.kinds[slot] != self.kinds[own]]
        return [(slot, lead) for slot in others if (lead := self._lead(blob, slot)) is not None]

    @cached_property
    def _choices(self) -> dict[int, list[int]]:
        """The free slots that each blob may have."""
        choices: dict[int, list[int]] = {blob: [] for blob, _ in self.square}
        for blob, slot in self.square:
            if slot in self.free:
                choices[blob].append(slot)
        return choices

    @cached_property
    def _owner(self) -> dict[int, int]:
        return {taken: holder for holder, taken in self.assigned.items()}

    @cached_property
    def _cost(self) -> npt.NDArray[np.float64]:
        """Every blob's mean square distance in every slot, infinite where it does not fit."""
        rows, columns = (1 + max(key[axis] for key in self.square) for axis in (0, 1))
        cost = np.full((rows, columns), np.inf)
        for key, value in self.square.items():
            cost[key] = value
        return cost

    def _lead(self, blob: int, slot: int) -> float | None:
        """Return by how much the best assignment with this blob in that slot fits worse than the one that was made."""
        owner = self._owner
        lead = self.square[(blob, slot)] - self.square[(blob, self.assigned[blob])]
        if slot not in owner:
            return lead
        # Whoever is driven out may drive out others: all that can be reached this way are assigned anew.
        moved: list[int] = []
        slots = {self.assigned[blob]}
        waiting = [owner[slot]]
        while waiting:
            holder = waiting.pop()
            moved.append(holder)
            for other in self._choices.get(holder, ()):
                if other != slot and other not in slots:
                    slots.add(other)
                    if other in owner and owner[other] not in (blob, *moved, *waiting):
                        waiting.append(owner[other])
        columns = sorted(slots)
        cost = self._cost[np.ix_(moved, columns)]
        pairs = assign(cost)
        if len(pairs) < len(moved):
            return None
        now = sum(self.square.get((holder, self.assigned[holder]), 0.0) for holder in moved)
        return lead + sum(float(cost[pair]) for pair in pairs) - now


def _turn(first: Explanation, second: Explanation, order: int) -> float:
    """Return by how many degrees two rotations of a slot differ, those that look alike counted as one."""
    step = 360.0 / order
    turns = (second.rotation_deg - first.rotation_deg) / step
    return abs(turns - round(turns)) * step


def kinds_of(slots: Sequence[Polygon], tolerance_mm: float) -> tuple[int, ...]:
    """Return a number for each slot: the same one for slots whose outlines are the same, turned or not.

    ``tolerance_mm``: by how much corners may leave the other outline.
    """
    perimeters = np.array([slot.perimeter_mm for slot in slots])
    areas = np.array([slot.area_mm2 for slot in slots])
    # A corner off by the tolerance changes perimeter and area by no more than this.
    slack = 2.0 * tolerance_mm * np.array([len(slot.vertices) for slot in slots])
    strip = 2.0 * tolerance_mm * perimeters
    kinds: list[int] = []
    models: list[int] = []
    for index, slot in enumerate(slots):
        near = np.abs(perimeters[models] - perimeters[index]) <= np.maximum(slack[models], slack[index])
        near &= np.abs(areas[models] - areas[index]) <= np.maximum(strip[models], strip[index])
        same = next(
            (int(kind) for kind in np.flatnonzero(near) if _same_outline(slot, slots[models[kind]], tolerance_mm)), None
        )
        if same is None:
            same = len(models)
            models.append(index)
        kinds.append(same)
    return tuple(kinds)


def _same_outline(first: Polygon, second: Polygon, tolerance_mm: float) -> bool:
    """Return whether some rotation lays one outline over the other, without turning it over."""
    corners, others = first.vertices - first.centroid, second.vertices - second.centroid
    radius, radii = np.hypot(*corners.T), np.hypot(*others.T)
    farthest = int(np.argmax(radius))
    start = np.arctan2(corners[farthest, 1], corners[farthest, 0])
    # The farthest corner of one lies over a corner of the other that is as far.
    for index in np.flatnonzero(np.abs(radii - radius[farthest]) <= 2.0 * tolerance_mm):
        turn = float(np.rad2deg(np.arctan2(others[index, 1], others[index, 0]) - start))
        moved = RigidTransform2D(turn, 0.0, 0.0).apply(corners)
        off = max(distance_to_outline(moved, others).max(), distance_to_outline(others, moved).max())
        # The farthest corner alone sets the turn, and its own error turns all others as far.
        if off <= 2.0 * tolerance_mm:
            return True
    return False
