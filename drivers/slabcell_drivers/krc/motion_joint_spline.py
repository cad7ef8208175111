"""How do the axes move through a PTP_SPLINE block?  Through every point, without a stop."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from slabcell_drivers.krc.motion import MotionKind, Trajectory, plan_ptp
from slabcell_drivers.krc.motion_curve import MonotoneCurve
from slabcell_drivers.krc.motion_profile import Trapezoid
from slabcell_drivers.robot.arm import ArmModel, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["plan_joint_spline"]

_SAMPLES = 24
"""Places between two points at which speed and bend of the way are looked at."""


def plan_joint_spline(
    arm: ArmModel,
    start: Axes,
    targets: Sequence[Axes],
    percents: Sequence[tuple[float, float]],
    *,
    tool: Frame,
) -> Trajectory:
    """Return the move through all targets; ``marks_s`` has the time of each but the last.  Raises MotionError.

    ``percents`` has for each target the speed and the acceleration that hold on the way to it.

    Simplification against the controller: each axis runs on a cubic that stays between its points, and the same share
    of what is allowed is kept on the whole block.
    """
    places, points = [0.0], [start]
    reached: list[float] = []
    shares: list[tuple[float, float]] = []
    for target, (speed_percent, acceleration_percent) in zip(targets, percents, strict=True):
        leg = plan_ptp(arm, points[-1], target, speed_percent=speed_percent, acceleration_percent=acceleration_percent)
        if leg.duration_s > 0.0:
            places.append(places[-1] + leg.duration_s)
            points.append(target)
            shares.append((speed_percent / 100.0, acceleration_percent / 100.0))
        reached.append(places[-1])
    if len(points) == 1:
        return Trajectory(arm, MotionKind.SPLINE, start, start, 0.0, lambda _: start, tool=tool)
    curves = [MonotoneCurve.through(places, [p[i] for p in points], rests_at_ends=False) for i in range(6)]

    def axes_on(place: float) -> Axes:
        a1, a2, a3, a4, a5, a6 = (curve.at(place) for curve in curves)
        return (a1, a2, a3, a4, a5, a6)

    speed, acceleration = _limits(arm, axes_on, places, shares)
    profile = Trapezoid.fastest(places[-1], speed, acceleration)

    def axes_at(time_s: float) -> Axes:
        return axes_on(profile.position(time_s))

    return Trajectory(
        arm,
        MotionKind.SPLINE,
        start,
        points[-1],
        profile.duration_s,
        axes_at,
        profile.ramp_s,
        tool,
        tuple(profile.time_at(place) for place in reached[:-1]),
    )


def _limits(
    arm: ArmModel,
    axes_on: Callable[[float], Axes],
    places: Sequence[float],
    shares: Sequence[tuple[float, float]],
) -> tuple[float, float]:
    """Return how fast the way may be run, and how fast its speed may change, for every axis to keep its limits.

    Half of an axis' acceleration is for the bends of the way, half for the change of the speed along it.
    """
    speed, acceleration = math.inf, math.inf
    for (begin, end), (speed_share, acceleration_share) in zip(pairwise(places), shares, strict=True):
        step = (end - begin) / _SAMPLES
        for k in range(1, _SAMPLES):
            before, here, after = (axes_on(begin + step * (k + d)) for d in (-1, 0, 1))
            for i in range(6):
                slope = abs(after[i] - before[i]) / (2.0 * step)
                bend = abs(after[i] - 2.0 * here[i] + before[i]) / step**2
                allowed = arm.axis_acceleration_deg_s2[i] * acceleration_share / 2.0
                if slope > 1e-9:
                    speed = min(speed, arm.axis_speed_deg_s[i] * speed_share / slope)
                    acceleration = min(acceleration, allowed / slope)
                if bend > 1e-9:
                    speed = min(speed, math.sqrt(allowed / bend))
    return speed, acceleration
