"""Which way of holding and laying a slab turns the wrist least?  All of them at once, as arrays.

A tool whose axis is the flange's may stand on the slab in any direction, and a slab that looks alike after a turn may
be laid turned.  Both change A6 alone, and by the angle itself.
"""

import numpy as np

__all__ = ["least_turn"]

FAR_DEG = 1e9
"""Stands for an angle beyond the limits: no way through it is ever the least."""


def least_turn(
    at_pick_deg: float,
    at_places_deg: list[float],
    turns_deg: tuple[float, ...],
    limits_deg: tuple[float, float],
    before_deg: float | None,
) -> tuple[int, int, float]:
    """Return which place and which turn of the tool let A6 travel least, and where A6 then ends.

    ``at_pick_deg`` and ``at_places_deg`` are A6 with the tool unturned, ``before_deg`` is where A6 stands (None:
    anywhere).  The travel counts from there to the pick and on to the place.  Of equal ways the one with the smallest
    turn wins.  ``limits_deg`` span at least one whole turn.
    """
    turns = np.array(turns_deg)
    low, high = limits_deg
    angles = np.array([at_pick_deg, *at_places_deg])[:, None] + turns
    whole = np.ceil((low - angles) / 360.0)[:, :, None] + np.arange(int((high - low) // 360.0) + 1)
    turned = angles[:, :, None] + 360.0 * whole  # (the pick and the places, turn, k)
    allowed = turned <= high
    pick = np.where(allowed[0], turned[0], FAR_DEG)
    place = np.where(allowed[1:], turned[1:], -FAR_DEG)
    travel = np.abs(place[:, :, :, None] - pick[:, None, :])  # (place, turn, k at the place, k at the pick)
    if before_deg is not None:
        travel = np.abs(pick - before_deg)[:, None, :] + travel
    travel = travel.reshape(*travel.shape[:2], -1)
    nearest = travel.argmin(axis=2)
    least = travel.min(axis=2)
    which = int(np.where(least == least.min(), np.abs(turns), np.inf).argmin())
    way, turn = divmod(which, len(turns))
    return way, turn, float(place[way, turn, int(nearest[way, turn]) // pick.shape[1]])
