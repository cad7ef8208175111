"""Which way of holding and laying a slab turns the wrist least?

A tool whose axis is the flange's may stand on the slab in any direction, and a slab that looks alike after a turn may
be laid turned.  Both change A6 alone, and by the angle itself: from the pick to the place A6 moves by what the slab has
to turn, and the tool's direction only says from where.  So both are tried from the shortest way on, and what cannot be
shorter any more ends the search.  Plain floats: so few numbers are sooner compared than put into arrays.
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
    turn wins, then the first place, then the first turn.  ``limits_deg`` span at least one whole turn.
    """
    low, high = limits_deg
    picks: list[tuple[float, float, int, float]] = []  # way there, size of the turn, its number, A6
    for number, turn in enumerate(turns_deg):
        angles = _angles(at_pick_deg + turn, low, high)
        picks += [(0.0 if before_deg is None else abs(a6 - before_deg), abs(turn), number, a6) for a6 in angles]
    picks.sort()
    span = high - low
    moves: list[tuple[float, int, float]] = []  # way from pick to place, number of the place, the same with its sign
    for which, at_place_deg in enumerate(at_places_deg):
        moves += [(abs(move), which, move) for move in _angles(at_place_deg - at_pick_deg, -span, span)]
    moves.sort()
    best = (math.inf, math.inf, 0, 0)
    last = 0.0
    for far, which, move in moves:
        if far + picks[0][0] > best[0]:
            break
        for there, size, number, pick in picks:
            if there + far > best[0]:
                break
            way = (there + far, size, which, number)
            if way < best and low <= pick + move <= high:
                best, last = way, pick + move
    return best[2], best[3], last


def _angles(angle_deg: float, low: float, high: float) -> list[float]:
    """Return the angle with every number of whole turns within the limits, the lowest first."""
    whole = math.ceil((low - angle_deg) / 360.0)
    found: list[float] = []
    while (turned := angle_deg + 360.0 * whole) <= high:
        found.append(turned)
        whole += 1
    return found
