"""How does the tool run on a straight line while the wrist turns axis by axis?  LIN with $ORI_TYPE = #JOINT.

The wrist axes go evenly from where they are to where the target needs them, and A1 to A3 keep the tool centre point on
its line.  There is no wrist singularity on such a path; the orientation on the way is what the wrist axes make it.
"""

import math

from slabcell_drivers.krc.messages import MotionMessage
from slabcell_drivers.krc.motion import NULL_TOOL, MotionKind, PathLimits, Trajectory, tcp_pose
from slabcell_drivers.krc.motion_check import between, followed, steps_for
from slabcell_drivers.krc.motion_error import MotionError, as_motion_error
from slabcell_drivers.krc.motion_path import Line, Vector
from slabcell_drivers.krc.motion_profile import Trapezoid
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.arm_solve import solve_main_axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["plan_lin_joint"]

SAME_AXES_DEG = 1e-6


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

    wrist = _WristFollower(arm, start, goal, line, point, profile)
    steps = steps_for(profile.duration_s, line.length_mm, max(abs(goal[i] - start[i]) for i in range(6)))
    samples = followed(arm, start, profile.duration_s, steps, wrist)
    if max(abs(p - q) for p, q in zip(samples[-1], goal, strict=True)) > SAME_AXES_DEG:
        text = "Work envelope exceeded: the target needs another status than the start; use PTP"
        raise MotionError(MotionMessage.UNREACHABLE, text)

    def axes_at(time_s: float) -> Axes:
        if time_s <= 0.0:
            return start
        if time_s >= profile.duration_s:
            return goal
        near = between(samples, time_s / profile.duration_s)
        try:
            return wrist.solve(time_s, near)
        except MotionError:  # grazes a limit between two checked points: the straight way between them is inside
            return near

    return Trajectory(arm, MotionKind.LIN, start, goal, profile.duration_s, axes_at, profile.ramp_s, tool)


class _WristFollower:
    """A4 to A6 go evenly; A1 to A3 keep the point on the line, with shoulder and elbow on the side where they were."""

    def __init__(self, arm: ArmModel, start: Axes, goal: Axes, line: Line, point: Vector, profile: Trapezoid) -> None:
        self._arm, self._start, self._goal = arm, start, goal
        self._line, self._point, self._profile = line, point, profile
        first = self._candidates(0.0, start)
        self._side = min(first, key=lambda side: arm.travel_time_s(start, first[side]), default=0)

    def solve(self, time_s: float, near: Axes) -> Axes:
        """Return the axes at a time."""
        fraction = self._profile.position(time_s) if self._profile.duration_s else 1.0
        axes = self._candidates(fraction, near).get(self._side)
        if axes is None:
            text = "Work envelope exceeded: the wrist cannot turn axis by axis on this line; use PTP"
            raise MotionError(MotionMessage.UNREACHABLE, text)
        try:
            self._arm.check_limits(axes)
        except ArmError as error:
            raise as_motion_error(error) from error
        return axes

    def accept(self, axes: Axes) -> None:
        """Nothing to keep account of: there is no singularity."""

    def _candidates(self, fraction: float, near: Axes) -> dict[int, Axes]:
        a4, a5, a6 = (self._start[i] + fraction * (self._goal[i] - self._start[i]) for i in (3, 4, 5))
        found = solve_main_axes(self._arm.dimensions, (a4, a5, a6), self._point, self._line.at(fraction))
        return {
            side: (_nearest_turn(a1, near[0]), _nearest_turn(a2, near[1]), _nearest_turn(a3, near[2]), a4, a5, a6)
            for side, (a1, a2, a3) in found
        }


def _nearest_turn(angle_deg: float, near_deg: float) -> float:
    return angle_deg + 360.0 * round((near_deg - angle_deg) / 360.0)


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
