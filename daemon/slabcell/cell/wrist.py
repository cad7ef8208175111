"""Which way of holding and laying a slab turns the wrist least?  All of them, one after the other.

A tool whose axis is the flange's may stand on the slab in any direction, and a slab that looks alike after a turn may
be laid turned.  Both change A6 alone, and by the angle itself.  Plain floats: so few numbers are sooner compared than
put into arrays.
"""

import math
from collections.abc import Sequence

__all__ = ["least_turn"]


def least_turn(
    at_pick_deg: float,
    at_places_deg: Sequence[float],
    turns_deg: Sequence[float],
    limits_deg: tuple[float, float],
    before_deg: float | None,
) -> tuple[int, int, float]:
    """Return which place and which turn of the tool let A6 travel least, and where A6 then ends.

    ``at_pick_deg`` and ``at_places_deg`` are A6 with the tool unturned, ``before_deg`` is where A6 stands (None:
    anywhere).  The travel counts from there to the pick and on to the place.  Of equal ways the one with the smallest
    turn wins.  ``limits_deg`` span at least one whole turn.
    """
    # For each turn, where A6 may be at the pick, and how far it is there.
    picks = [
        [
            (pick, 0.0 if before_deg is None else abs(pick - before_deg))
            for pick in _angles(at_pick_deg + turn, limits_deg)
        ]
        for turn in turns_deg
    ]
    least, way, number, last = math.inf, 0, 0, 0.0
    for which, at_place_deg in enumerate(at_places_deg):
        for tried, turn in enumerate(turns_deg):
            travel, end = math.inf, 0.0
            for place in _angles(at_place_deg + turn, limits_deg):
                for pick, way_there in picks[tried]:
                    whole = way_there + abs(place - pick)
                    if whole < travel:
                        travel, end = whole, place
            if travel < least or (travel == least and abs(turn) < abs(turns_deg[number])):
                least, way, number, last = travel, which, tried, end
    return way, number, last


def _angles(angle_deg: float, limits_deg: tuple[float, float]) -> list[float]:
    """Return the angle with every number of whole turns within the limits, the lowest first."""
    low, high = limits_deg
    whole = math.ceil((low - angle_deg) / 360.0)
    found: list[float] = []
    while (turned := angle_deg + 360.0 * whole) <= high:
        found.append(turned)
        whole += 1
    return found
