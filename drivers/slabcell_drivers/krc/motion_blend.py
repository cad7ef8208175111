"""How does one move pass into the next without a stop?  Approximate positioning (C_PTP, C_DIS, C_VEL, C_ORI).

Simplification against the controller: the next move begins while this one still slows down, and the two are added axis
by axis.  The corner is rounded within the distance that was asked for, and the speed stays that of the moves; the exact
shape of the controller's curve is not public.  Rounding begins no earlier than the slowing down does.
"""

import math
from dataclasses import dataclass

from slabcell_drivers.krc.motion import MotionKind, Trajectory
from slabcell_drivers.krc.motion_path import Turning, quaternion_of
from slabcell_drivers.robot.arm import Axes

__all__ = ["Approximation", "Blend", "blend"]


@dataclass(frozen=True, slots=True)
class Approximation:
    """How near to its target a move may be left: None where that does not limit.

    In KRL: $APO.CDIS, $APO.CORI, and $APO.CPTP or $APO.CVEL as a share of the slowing down (100 % is all of it).
    """

    distance_mm: float | None = None
    angle_deg: float | None = None
    percent: float = 100.0


@dataclass(frozen=True, slots=True)
class Blend:
    """Two moves as one.  ``begins_s`` is when the second begins, ``ends_s`` when the first would have ended."""

    trajectory: Trajectory
    begins_s: float
    ends_s: float


def blend(first: Trajectory, second: Trajectory, approximation: Approximation) -> Blend:
    """Return both moves as one; ``second`` must start where ``first`` ends.

    An approximation of nothing, or moves without a way, are joined with a stop between them.
    """
    window_s = min(first.ramp_s, second.ramp_s, first.duration_s / 2.0, second.duration_s / 2.0)
    begins_s = first.duration_s - window_s * min(max(approximation.percent, 0.0), 100.0) / 100.0
    begins_s = _first_within(first, approximation, begins_s)
    base = second.start_axes

    def axes_at(time_s: float) -> Axes:
        here = first.axes_at(time_s)
        if time_s <= begins_s:
            return here
        if time_s >= first.duration_s:
            return second.axes_at(time_s - begins_s)
        ahead = second.axes_at(time_s - begins_s)
        return (
            here[0] + ahead[0] - base[0],
            here[1] + ahead[1] - base[1],
            here[2] + ahead[2] - base[2],
            here[3] + ahead[3] - base[3],
            here[4] + ahead[4] - base[4],
            here[5] + ahead[5] - base[5],
        )

    joined = Trajectory(
        arm=first.arm,
        kind=MotionKind.BLENDED,
        start_axes=first.start_axes,
        end_axes=second.end_axes,
        duration_s=begins_s + second.duration_s,
        axes_at=axes_at,
        ramp_s=second.ramp_s,
        tool=second.tool,
        marks_s=(*first.marks_s, (begins_s + first.duration_s) / 2.0, *(begins_s + m for m in second.marks_s)),
    )
    return Blend(joined, begins_s, first.duration_s)


def _first_within(first: Trajectory, approximation: Approximation, earliest_s: float) -> float:
    """Return the first time, not before ``earliest_s``, at which the target is as near as the approximation wants."""
    target = first.tcp_at(first.duration_s)

    def near(time_s: float) -> bool:
        tcp = first.tcp_at(time_s)
        limit_mm = math.inf if approximation.distance_mm is None else approximation.distance_mm
        if math.dist(tcp.position, target.position) > limit_mm:
            return False
        if approximation.angle_deg is None:
            return True
        turn = Turning.between(quaternion_of(tcp.rotation), quaternion_of(target.rotation))
        return turn.angle_deg <= approximation.angle_deg

    if near(earliest_s):
        return earliest_s
    low, high = earliest_s, first.duration_s
    for _ in range(30):  # while slowing down the distance only shrinks
        middle = (low + high) / 2.0
        low, high = (low, middle) if near(middle) else (middle, high)
    return high
