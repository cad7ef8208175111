"""How does the tool run on a straight line while the wrist turns axis by axis?  LIN with $ORI_TYPE = #JOINT.

The wrist axes go evenly from where they are to where the target needs them, and A1 to A3 keep the tool centre point on
its line.  There is no wrist singularity on such a path; the orientation on the way is what the wrist axes make it.
"""

import math
from collections.abc import Callable

from slabcell_drivers.krc.motion import (
    AXIS_SPEED_TOLERANCE,
    CHECK_EVERY_MM,
    INTERPOLATION_TICK_S,
    NULL_TOOL,
    MotionError,
    MotionKind,
    PathLimits,
    Trajectory,
    as_motion_error,
    tcp_pose,
)
from slabcell_drivers.krc.motion_path import Line
from slabcell_drivers.krc.motion_profile import Trapezoid
from slabcell_drivers.krc.unconfirmed import MotionMessage
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.arm_solve import solve_main_axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["plan_lin_joint"]


def plan_lin_joint(
    arm: ArmModel, start: Axes, target: Frame, limits: PathLimits, *, tool: Frame = NULL_TOOL
) -> Trajectory:
    """Return the move of the tool centre point on a straight line to ``target`` (in the root frame).

    Raises MotionError: out of reach, axis limit, axis too fast.
    """
    try:
        goal = arm.inverse(target @ tool.inverse(), near=start)
    except ArmError as error:
        raise as_motion_error(error) from error
    line = Line(tcp_pose(arm, start, tool).position, tcp_pose(arm, goal, tool).position)
    profile = _profile(arm, start, goal, line.length_mm, limits)
    point = (tool.x_mm, tool.y_mm, tool.z_mm)

    def axes_of(fraction: float, near: Axes) -> Axes:
        a4, a5, a6 = (start[i] + fraction * (goal[i] - start[i]) for i in (3, 4, 5))
        found = solve_main_axes(arm.dimensions, (a4, a5, a6), point, line.at(fraction))
        candidates = [(a[0], a[1], a[2], a4, a5, a6) for a in found]
        if not candidates:
            text = "Work envelope exceeded: the wrist cannot turn axis by axis on this line; use PTP"
            raise MotionError(MotionMessage.UNREACHABLE, text)
        return min(candidates, key=lambda axes: arm.travel_time_s(near, axes))

    samples = _samples(arm, start, goal, profile, line.length_mm, axes_of)
    steps = len(samples) - 1

    def axes_at(time_s: float) -> Axes:
        if time_s <= 0.0:
            return start
        if time_s >= profile.duration_s:
            return goal
        return axes_of(profile.position(time_s), samples[round(time_s / profile.duration_s * steps)])

    return Trajectory(arm, MotionKind.LIN, start, goal, profile.duration_s, axes_at, profile.ramp_s, tool)


def _profile(arm: ArmModel, start: Axes, goal: Axes, length_mm: float, limits: PathLimits) -> Trapezoid:
    """Return the profile over the fraction of the way that the path and each wrist axis allow."""
    speeds, accelerations = [math.inf], [math.inf]
    if length_mm > 1e-6:
        speeds.append(limits.speed_m_s * 1000.0 / length_mm)
        accelerations.append(limits.acceleration_m_s2 * 1000.0 / length_mm)
    for i in (3, 4, 5):
        turn = abs(goal[i] - start[i])
        if turn > 1e-6:
            speeds.append(arm.axis_speed_deg_s[i] / turn)
            accelerations.append(arm.axis_acceleration_deg_s2[i] / turn)
    if len(speeds) == 1:
        return Trapezoid.fastest(0.0, 1.0, 1.0)
    if min(speeds) <= 0.0 or min(accelerations) <= 0.0:
        raise MotionError(MotionMessage.VALUE, "$VEL.CP and $ACC.CP have to be above 0")
    return Trapezoid.fastest(1.0, min(speeds), min(accelerations))


def _samples(
    arm: ArmModel, start: Axes, goal: Axes, profile: Trapezoid, length_mm: float, axes_of: Callable[[float, Axes], Axes]
) -> list[Axes]:
    """Return the axes along the way, checked against limits and speeds."""
    steps = max(1, round(min(profile.duration_s / INTERPOLATION_TICK_S, max(length_mm / CHECK_EVERY_MM, 50.0))))
    step_s = profile.duration_s / steps
    samples = [start]
    for step in range(1, steps + 1):
        before = samples[-1]
        axes = goal if step == steps else axes_of(profile.position(step_s * step), before)
        try:
            arm.check_limits(axes)
        except ArmError as error:
            raise as_motion_error(error) from error
        for i in range(6):
            moved, allowed = abs(axes[i] - before[i]), arm.axis_speed_deg_s[i]
            if moved > allowed * step_s * AXIS_SPEED_TOLERANCE + 1e-6:
                text = (
                    f"Command velocity exceeded A{i + 1}: {moved / step_s:.0f}°/s on the path, "
                    f"{allowed:.0f}°/s allowed; reduce $VEL.CP or use PTP"
                )
                raise MotionError(MotionMessage.AXIS_SPEED, text)
        samples.append(axes)
    return samples
