"""Is the best explanation of a blob sure?  Not where another slot or another rotation explains it about as well.

Two explanations are told apart by how much worse the second one fits what is seen: the root of the difference of the
squared RMS distances is the RMS distance between what both expect, as far as the picture supports it.  Slots of the
same outline are no doubt, and neither are rotations that look alike: they come to the same.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.vision.outline import distance_to_outline

__all__ = ["Explanation", "doubts", "kinds_of"]

# Rotations that differ by less are one.
SAME_TURN_DEG: Final = 3.0
# What the best explanation leaves over may hide the difference to another: the lead must be this share of it.
SHARE_OF_RESIDUAL: Final = 0.5


@dataclass(frozen=True, slots=True)
class Explanation:
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
    best: dict[tuple[int, int], float] = {}
    for item in explanations:
        key = (item.blob, kinds[item.slot])
        best[key] = min(item.evidence_mm, best.get(key, np.inf))
    owner = {slot: blob for blob, slot in assigned.items()}
    found: dict[int, str] = {}
    for blob, slot in assigned.items():
        own = [item for item in of_blob.get(blob, []) if item.slot == slot]
        if not own:
            continue
        first = min(own, key=lambda item: item.evidence_mm)
        needed = max(min_lead_mm, SHARE_OF_RESIDUAL * first.evidence_mm)
        for other in sorted(of_blob[blob], key=lambda item: item.evidence_mm):
            if other.slot == slot:
                turned = _turn(first, other, orders[slot])
                if turned <= SAME_TURN_DEG:
                    continue
                lead = other.evidence_mm**2 - first.evidence_mm**2
                what = f"lies in slot {slot} as it is or turned by {turned:.0f}°"
            else:
                if kinds[other.slot] == kinds[slot] or other.slot not in free:
                    continue
                lead = other.evidence_mm**2 - first.evidence_mm**2
                partner = owner.get(other.slot)
                if partner is not None:
                    # The other slot has a slab: both would have to change places.
                    mine, theirs = best.get((partner, kinds[slot])), best[(partner, kinds[other.slot])]
                    if mine is None:
                        continue
                    lead += mine**2 - theirs**2
                what = f"fits slot {slot} and slot {other.slot}"
            apart = float(np.sqrt(max(lead, 0.0)))
            if apart < needed:
                found[blob] = f"{what} alike: {apart:.3f} mm tell them apart, {needed:.3f} mm are needed"
                break
    return found


def _turn(first: Explanation, second: Explanation, order: int) -> float:
    """Return by how many degrees two rotations of a slot differ, those that look alike counted as one."""
    step = 360.0 / order
    turns = (second.rotation_deg - first.rotation_deg) / step
    return abs(turns - round(turns)) * step


def kinds_of(slots: Sequence[Polygon], tolerance_mm: float) -> tuple[int, ...]:
    """Return a number for each slot: the same one for slots whose outlines are the same, turned or not."""
    kinds: list[int] = []
    models: list[Polygon] = []
    for slot in slots:
        same = next((kind for kind, model in enumerate(models) if _same_outline(slot, model, tolerance_mm)), None)
        if same is None:
            same = len(models)
            models.append(slot)
        kinds.append(same)
    return tuple(kinds)


def _same_outline(first: Polygon, second: Polygon, tolerance_mm: float) -> bool:
    """Return whether some rotation lays one outline over the other, without turning it over."""
    slack = 2.0 * tolerance_mm
    if abs(first.perimeter_mm - second.perimeter_mm) > slack * max(len(first.vertices), len(second.vertices)):
        return False
    if abs(first.area_mm2 - second.area_mm2) > slack * max(first.perimeter_mm, second.perimeter_mm):
        return False
    corners, others = first.vertices - first.centroid, second.vertices - second.centroid
    radius, radii = np.hypot(*corners.T), np.hypot(*others.T)
    farthest = int(np.argmax(radius))
    start = np.arctan2(corners[farthest, 1], corners[farthest, 0])
    # The farthest corner of one lies over a corner of the other that is as far.
    for index in np.flatnonzero(np.abs(radii - radius[farthest]) <= slack):
        turn = float(np.rad2deg(np.arctan2(others[index, 1], others[index, 0]) - start))
        moved = RigidTransform2D(turn, 0.0, 0.0).apply(corners)
        if distance_to_outline(moved, others).max() <= slack and distance_to_outline(others, moved).max() <= slack:
            return True
    return False
