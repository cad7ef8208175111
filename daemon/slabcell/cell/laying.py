"""In which order are slabs laid?  So that each one, while it is lowered, has a side to which it can give way.

A slab between two that lie already, on opposite sides, is pinched: whatever their placing errors are, there is no room
for them.  Slots are taken one after the other such that as few as possible are ever pinched, and so that what lies
grows as one piece.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import lru_cache

import numpy as np
import shapely

from slabcell.geometry import Polygon

__all__ = ["LayingOrder"]

CONTACT_MM = 1.5
"""Edges nearer than this are neighbours: a template's joints are narrower, a gap that is meant to be one is wider."""

JUDGEMENTS_REMEMBERED = 1 << 16
ORDERS_REMEMBERED = 256
SHORTEST_MM = 2.0  # two corners that meet are no contact
HALF_TURN = math.pi * (1.0 - 1e-3)  # nearly parallel edges pinch like parallel ones


class LayingOrder:
    """What a template says about the order: for each slot, its neighbours and on which side they lie.

    Sets of slots are bits of an integer here, and what a slot's neighbours mean for it is judged once.
    """

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
        self._beside = [_bits(sides) for sides in self._sides]
        self._pinched_by = lru_cache(JUDGEMENTS_REMEMBERED)(self._is_pinched_by)
        self._in_order = lru_cache(ORDERS_REMEMBERED)(self._find_order)

    def order(
        self, available: Iterable[int], laid: Iterable[int], after: Mapping[int, Collection[int]] | None = None
    ) -> list[int]:
        """Return the available slots in the order in which they shall be laid onto what lies already.

        ``after`` names what has to lie before a slot is filled; a slot whose turn cannot come is left out.
        """
        if after:
            return self._find_order(
                _bits(available), _bits(laid), {slot: _bits(first) for slot, first in after.items()}
            )
        return self._in_order(_bits(available), _bits(laid)).copy()  # job after job begins in the same way

    def _find_order(self, available: int, lies: int, needed: Mapping[int, int] | None = None) -> list[int]:
        left = [slot for slot in range(len(self._sides)) if available >> slot & 1]
        result: list[int] = []
        costs: dict[int, tuple[int, int, float, int]] = {}
        while left:
            for slot in left:
                if slot not in costs:
                    costs[slot] = self._cost(slot, lies)
            ready = [slot for slot in left if not needed.get(slot, 0) & ~lies] if needed else left
            if not ready:
                break
            slot = min(ready, key=costs.__getitem__)
            left.remove(slot)
            lies |= 1 << slot
            result.append(slot)
            # Only what lies near the new slab is judged otherwise now.
            for near in self._sides[slot]:
                costs.pop(near, None)
                for further in self._sides[near]:
                    costs.pop(further, None)
        return result

    def pinched(self, slot: int, laid: Collection[int]) -> bool:
        """Tell whether a slab in this slot would lie between others on opposite sides."""
        return self._is_pinched(slot, _bits(laid))

    def _is_pinched(self, slot: int, laid: int) -> bool:
        return self._pinched_by(slot, laid & self._beside[slot])

    def _is_pinched_by(self, slot: int, neighbours: int) -> bool:
        sides = self._sides[slot].items()
        normals = sorted(a for other, (angles, _) in sides if neighbours >> other & 1 for a in angles)
        if len(normals) < 2:
            return False
        gaps = [b - a for a, b in zip(normals, [*normals[1:], normals[0] + 2.0 * math.pi], strict=True)]
        return max(gaps) <= math.pi + (math.pi - HALF_TURN)

    def _cost(self, slot: int, laid: int) -> tuple[int, int, float, int]:
        """Return what speaks against this slot as the next: the less the better."""
        harmed, contact_mm, then = 0, 0.0, laid | 1 << slot
        for near, (_, length) in self._sides[slot].items():
            if laid >> near & 1:
                contact_mm += length
            elif not self._is_pinched(near, laid) and self._is_pinched(near, then):
                harmed += 1
        return int(self._is_pinched(slot, laid)), harmed, -contact_mm, slot


def _bits(slots: Iterable[int]) -> int:
    """Return a set of slots as the bits of an integer."""
    result = 0
    for slot in slots:
        result |= 1 << slot
    return result


def _contact(slot: Polygon, other: shapely.Polygon) -> tuple[list[float], float]:
    """Return the outward directions, in radians, of the edges that touch the other slot, and their length in mm."""
    ends = np.roll(slot.vertices, -1, axis=0)
    edges = [shapely.LineString(pair) for pair in np.stack([slot.vertices, ends], axis=1)]
    lengths = np.array([edge.intersection(other).length for edge in edges])
    # The ends of an edge that runs away from the other slot are near it too: less than the contact distance counts not.
    touching = lengths > max(SHORTEST_MM, 2.0 * CONTACT_MM)
    dx, dy = (ends - slot.vertices).T
    return [float(a) for a in np.arctan2(-dx, dy)[touching]], float(lengths[touching].sum())
