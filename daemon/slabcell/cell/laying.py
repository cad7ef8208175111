"""In which order are slabs laid?  So that each one, while it is lowered, has a side to which it can give way.

A slab between two that lie already, on opposite sides, is pinched: whatever their placing errors are, there is no room
for them.  Slots are taken one after the other such that as few as possible are ever pinched, and so that what lies
grows as one piece.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
import shapely

from slabcell.geometry import Polygon

__all__ = ["LayingOrder"]

CONTACT_MM = 1.5
"""Edges nearer than this are neighbours: a template's joints are narrower, a gap that is meant to be one is wider."""

SHORTEST_MM = 2.0  # two corners that meet are no contact
HALF_TURN = math.pi * (1.0 - 1e-3)  # nearly parallel edges pinch like parallel ones


class LayingOrder:
    """What a template says about the order: for each slot, its neighbours and on which side they lie."""

    def __init__(self, slots: Sequence[Polygon]) -> None:
        self._sides: list[dict[int, tuple[list[float], float]]] = [{} for _ in slots]
        shapes = [slot.shape for slot in slots]
        grown = [shape.buffer(CONTACT_MM) for shape in shapes]
        tree = shapely.STRtree(shapes)
        pairs: list[tuple[int, int]] = tree.query(grown, predicate="intersects").T.tolist()
        for slot, other in pairs:
            if slot != other:
                contact = _contact(slots[slot], grown[other])
                if contact[1] >= SHORTEST_MM:
                    self._sides[slot][other] = contact

    def order(
        self, available: Iterable[int], laid: Iterable[int], after: Mapping[int, Collection[int]] | None = None
    ) -> list[int]:
        """Return the available slots in the order in which they shall be laid onto what lies already.

        ``after`` names what has to lie before a slot is filled; a slot whose turn cannot come is left out.
        """
        needed = after or {}
        lies, left = set(laid), sorted(set(available))
        result: list[int] = []
        costs: dict[int, tuple[int, int, float, int]] = {}
        while left:
            for slot in left:
                if slot not in costs:
                    costs[slot] = self._cost(slot, lies)
            ready = [slot for slot in left if lies.issuperset(needed.get(slot, ()))] if needed else left
            if not ready:
                break
            slot = min(ready, key=lambda item: costs[item])
            left.remove(slot)
            lies.add(slot)
            result.append(slot)
            # Only what lies near the new slab is judged otherwise now.
            for near in self._sides[slot]:
                costs.pop(near, None)
                for further in self._sides[near]:
                    costs.pop(further, None)
        return result

    def pinched(self, slot: int, laid: Collection[int]) -> bool:
        """Tell whether a slab in this slot would lie between others on opposite sides."""
        normals = sorted(a for other, (angles, _) in self._sides[slot].items() if other in laid for a in angles)
        if len(normals) < 2:
            return False
        gaps = [b - a for a, b in zip(normals, [*normals[1:], normals[0] + 2.0 * math.pi], strict=True)]
        return max(gaps) <= math.pi + (math.pi - HALF_TURN)

    def _cost(self, slot: int, laid: set[int]) -> tuple[int, int, float, int]:
        """Return what speaks against this slot as the next: the less the better."""
        harmed = 0
        for near in self._sides[slot]:
            if near not in laid and not self.pinched(near, laid) and self.pinched(near, laid | {slot}):
                harmed += 1
        contact_mm = sum(length for other, (_, length) in self._sides[slot].items() if other in laid)
        return int(self.pinched(slot, laid)), harmed, -contact_mm, slot


def _contact(slot: Polygon, other: shapely.Polygon) -> tuple[list[float], float]:
    """Return the outward directions, in radians, of the edges that touch the other slot, and their length in mm."""
    ends = np.roll(slot.vertices, -1, axis=0)
    edges = [shapely.LineString(pair) for pair in np.stack([slot.vertices, ends], axis=1)]
    lengths = np.array([edge.intersection(other).length for edge in edges])
    # The ends of an edge that runs away from the other slot are near it too: less than the contact distance counts not.
    touching = lengths > max(SHORTEST_MM, 2.0 * CONTACT_MM)
    dx, dy = (ends - slot.vertices).T
    return [float(a) for a in np.arctan2(-dx, dy)[touching]], float(lengths[touching].sum())
