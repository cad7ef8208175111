"""How does a spline keep what TIME_BLOCK and CONST_VEL demand?  Times of its sections, and an even speed in between."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from slabcell_drivers.krc.messages import MotionMessage, RunMessage
from slabcell_drivers.krc.motion import INTERPOLATION_TICK_S, MotionError, Trajectory
from slabcell_drivers.krc.motion_curve import MonotoneCurve
from slabcell_drivers.robot.arm import Axes

__all__ = ["EvenSpeed", "TimeBlock", "retimed", "speed_remarks"]

_SPEED_TOLERANCE = 0.99
_AXIS_TOLERANCE = 1.02


@dataclass(frozen=True, slots=True)
class TimeBlock:
    """The part of a spline behind ``first`` segments takes ``seconds``.

    ``parts`` has the ends of its sections, as numbers of segments, and the percentage of the time that each takes.
    """

    first: int
    parts: tuple[tuple[int, float], ...]
    seconds: float


@dataclass(frozen=True, slots=True)
class EvenSpeed:
    """From one time of a spline to another the programmed speed has to be kept."""

    begins_s: float
    ends_s: float
    speed_m_s: float


def retimed(trajectory: Trajectory, block: TimeBlock) -> Trajectory:
    """Return the move with the times that the block demands.  Raises MotionError if an axis were too fast for them.

    Simplification against the controller: the move's own speed is stretched smoothly between the ends of the sections.
    """
    ends_s = (0.0, *trajectory.marks_s, trajectory.duration_s)
    total = sum(percent for _, percent in block.parts)
    own, wanted = [0.0], [0.0]
    for k in range(1, len(ends_s)):
        before_s = wanted[-1]
        if k <= block.first:
            at_s = before_s + ends_s[k] - ends_s[k - 1]
        elif (percent := dict(block.parts).get(k)) is not None:
            at_s = before_s + block.seconds * percent / total
        elif k < block.parts[-1][0]:
            continue  # within a section
        else:
            at_s = before_s + ends_s[k] - own[-1]
        if ends_s[k] - own[-1] > 1e-9:
            own.append(ends_s[k])
            wanted.append(at_s)
    if len(own) < 2:
        return trajectory
    warp, back = (MonotoneCurve.through(a, b, rests_at_ends=False) for a, b in ((wanted, own), (own, wanted)))

    def axes_at(time_s: float) -> Axes:
        return trajectory.axes_at(warp.at(time_s))

    result = replace(
        trajectory,
        duration_s=wanted[-1],
        axes_at=axes_at,
        marks_s=tuple(back.at(mark) for mark in trajectory.marks_s),
    )
    _check_speed(result)
    return result


def _check_speed(trajectory: Trajectory) -> None:
    steps = max(1, math.ceil(trajectory.duration_s / INTERPOLATION_TICK_S))
    step_s = trajectory.duration_s / steps
    before = trajectory.axes_at(0.0)
    for k in range(1, steps + 1):
        now = trajectory.axes_at(k * step_s)
        for i, limit in enumerate(trajectory.arm.axis_speed_deg_s):
            speed = abs(now[i] - before[i]) / step_s
            if speed > limit * _AXIS_TOLERANCE:
                text = f"Command velocity A{i + 1}: TIME_BLOCK needs {speed:.0f}°/s, {limit:.0f}°/s allowed"
                raise MotionError(MotionMessage.AXIS_SPEED, text)
        before = now


def speed_remarks(trajectory: Trajectory, wanted: EvenSpeed) -> list[tuple[int, str]]:
    """Return what the controller says where the programmed speed is not kept between START and END of CONST_VEL."""
    steps = max(1, math.floor((wanted.ends_s - wanted.begins_s) / INTERPOLATION_TICK_S))
    times = [wanted.begins_s + (wanted.ends_s - wanted.begins_s) * k / steps for k in range(steps + 1)]
    speeds = _speeds(trajectory, times)
    if min(speeds) >= wanted.speed_m_s * _SPEED_TOLERANCE:
        return []
    reached = f"Instead of $VEL.CP = {wanted.speed_m_s:g} m/s, only {{:.3f}} m/s is reached."
    if max(speeds) < wanted.speed_m_s * _SPEED_TOLERANCE:
        text = f"$VEL.CP = {wanted.speed_m_s:g} m/s cannot be implemented in CONST_VEL range: {max(speeds):.3f} m/s"
        return [(RunMessage.CONSTANT_SPEED_REDUCED, text)]
    found: list[tuple[int, str]] = []
    if speeds[0] < wanted.speed_m_s * _SPEED_TOLERANCE:
        text = f"Acceleration distance for CONST_VEL START is too short. {reached.format(speeds[0])}"
        found.append((RunMessage.CONSTANT_SPEED_LATE, text))
    if speeds[-1] < wanted.speed_m_s * _SPEED_TOLERANCE:
        text = f"Braking distance for CONST_VEL END is too short. {reached.format(speeds[-1])}"
        found.append((RunMessage.CONSTANT_SPEED_EARLY, text))
    return found


def _speeds(trajectory: Trajectory, times: Sequence[float]) -> list[float]:
    """Return the speed of the tool centre point at these times, in m/s."""
    half_s = 0.0005
    found: list[float] = []
    for time_s in times:
        before = trajectory.tcp_at(max(0.0, time_s - half_s)).position
        after = trajectory.tcp_at(min(trajectory.duration_s, time_s + half_s)).position
        found.append(math.dist(before, after) / (2000.0 * half_s))
    return found
