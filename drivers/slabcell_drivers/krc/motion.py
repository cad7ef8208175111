"""How does the arm get from here to there, and may it?  Plans of PTP, LIN and CIRC moves as trajectories over time.

A plan is made whole before the arm moves, and every check is made with it: axis limits, reach, wrist singularity and,
along a path, the speed of each axis.  What fails raises `MotionError` with the number and text of a controller message.

Simplifications against the controller: trapezoidal speed (no jerk limit), all axes of a PTP in phase, orientation along
a path turned about one fixed axis, accelerations assumed (see `slabcell_drivers.robot.arm`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from slabcell_drivers.krc.messages import MotionMessage
from slabcell_drivers.krc.motion_check import PoseFollower, between, followed, steps_for
from slabcell_drivers.krc.motion_error import MotionError, as_motion_error
from slabcell_drivers.krc.motion_path import Arc, Line, OrientedPath, PosePath, flange_of
from slabcell_drivers.krc.motion_profile import Trapezoid
from slabcell_drivers.krc.motion_steps import Section, SpeedSteps
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.arm_solve import Pose, pose_of_frame
from slabcell_drivers.robot.frame import Frame

__all__ = [
    "INTERPOLATION_TICK_S",
    "MotionError",
    "MotionKind",
    "PathLimits",
    "Trajectory",
    "as_motion_error",
    "plan_circ",
    "plan_lin",
    "plan_path",
    "plan_ptp",
    "tcp_pose",
]

INTERPOLATION_TICK_S = 0.012
NULL_TOOL = Frame()


class MotionKind(StrEnum):
    """What a trajectory was planned as."""

    PTP = "PTP"
    LIN = "LIN"
    CIRC = "CIRC"
    SPLINE = "SPLINE"
    BLENDED = "BLENDED"
    STOPPED = "STOPPED"


@dataclass(frozen=True, slots=True)
class PathLimits:
    """Speeds and accelerations of the tool centre point: in KRL $VEL.CP, $ACC.CP, and the ORI1 values in degrees."""

    speed_m_s: float = 0.25
    acceleration_m_s2: float = 2.3
    turn_speed_deg_s: float = 200.0
    turn_acceleration_deg_s2: float = 1000.0


@dataclass(frozen=True, slots=True)
class Trajectory:
    """One planned move: where the axes are at every moment of it.

    Times before the start and after the end give the start and the end.
    """

    arm: ArmModel
    kind: MotionKind
    start_axes: Axes
    end_axes: Axes
    duration_s: float
    axes_at: Callable[[float], Axes]
    """Axis angles at a time in seconds after the start."""
    ramp_s: float = 0.0
    """How long the speed rises at the start, and falls at the end."""
    tool: Frame = NULL_TOOL
    marks_s: tuple[float, ...] = ()
    """When the points on the way are passed; the end is not among them."""

    def frame_at(self, time_s: float) -> Frame:
        """Return the flange in the root frame at a time in seconds after the start."""
        return self.arm.forward(self.axes_at(time_s))

    def tcp_at(self, time_s: float) -> Pose:
        """Return the tool centre point in the root frame at a time in seconds after the start."""
        return tcp_pose(self.arm, self.axes_at(time_s), self.tool)


def plan_ptp(
    arm: ArmModel,
    start: Axes,
    target: Axes,
    *,
    speed_percent: float = 100.0,
    acceleration_percent: float = 100.0,
    tool: Frame = NULL_TOOL,
) -> Trajectory:
    """Return the move in which every axis runs in step with the slowest.  Raises MotionError at an axis limit.

    The percentages are of the arm's axis speeds and accelerations ($VEL_AXIS, $ACC_AXIS).
    """
    _check_percent("velocity", speed_percent)
    _check_percent("acceleration", acceleration_percent)
    try:
        arm.check_limits(target)
    except ArmError as error:
        raise as_motion_error(error) from error
    # one profile over the fraction of the way keeps all axes in phase: the slowest axis sets speed and acceleration
    distance = tuple(target[i] - start[i] for i in range(6))
    moving = [i for i in range(6) if distance[i] != 0.0]
    if not moving:
        return Trajectory(arm, MotionKind.PTP, start, target, 0.0, lambda _: target, tool=tool)
    speed = min(arm.axis_speed_deg_s[i] * speed_percent / 100.0 / abs(distance[i]) for i in moving)
    acceleration = min(
        arm.axis_acceleration_deg_s2[i] * acceleration_percent / 100.0 / abs(distance[i]) for i in moving
    )
    profile = Trapezoid.fastest(1.0, speed, acceleration)

    def axes_at(time_s: float) -> Axes:
        s = profile.position(time_s)
        if s >= 1.0:
            return target
        return (
            start[0] + s * distance[0],
            start[1] + s * distance[1],
            start[2] + s * distance[2],
            start[3] + s * distance[3],
            start[4] + s * distance[4],
            start[5] + s * distance[5],
        )

    return Trajectory(arm, MotionKind.PTP, start, target, profile.duration_s, axes_at, profile.ramp_s, tool)


def plan_lin(arm: ArmModel, start: Axes, target: Frame, limits: PathLimits, *, tool: Frame = NULL_TOOL) -> Trajectory:
    """Return the move of the tool centre point on a straight line to ``target`` (in the root frame).

    The status is kept along the way and the turns follow the path, as on the controller, which ignores the S and T of
    such a target.  Raises MotionError: out of reach, axis limit, singularity, axis too fast.
    """
    tcp = tcp_pose(arm, start, tool)
    goal = pose_of_frame(target)
    path = OrientedPath.between(Line(tcp.position, goal.position), tcp, goal)
    return plan_path(arm, MotionKind.LIN, start, path, limits, tool)


def plan_circ(
    arm: ArmModel,
    start: Axes,
    auxiliary: Frame,
    target: Frame,
    limits: PathLimits,
    *,
    tool: Frame = NULL_TOOL,
    circular_angle_deg: float | None = None,
) -> Trajectory:
    """Return the move on the circle through the auxiliary point to ``target``, or over ``circular_angle_deg`` of it.

    The orientation turns from the start to that of ``target``; that of the auxiliary point is not regarded.  Raises
    MotionError as `plan_lin` does, and if the three points define no circle.
    """
    tcp = tcp_pose(arm, start, tool)
    aux, goal = pose_of_frame(auxiliary), pose_of_frame(target)
    try:
        arc = Arc.through(tcp.position, aux.position, goal.position, angle_deg=circular_angle_deg)
    except ValueError as error:
        raise MotionError(MotionMessage.CIRCLE, f"CIRC not possible: {error}") from error
    return plan_path(arm, MotionKind.CIRC, start, OrientedPath.between(arc, tcp, goal), limits, tool)


def tcp_pose(arm: ArmModel, axes: Axes, tool: Frame) -> Pose:
    """Return the tool centre point in the root frame."""
    flange = arm.forward_pose(axes)
    return flange if tool == NULL_TOOL else flange_of(flange, pose_of_frame(tool))


def plan_path(
    arm: ArmModel,
    kind: MotionKind,
    start: Axes,
    path: PosePath,
    limits: PathLimits,
    tool: Frame,
    *,
    sections: Sequence[PathLimits] = (),
) -> Trajectory:
    """Return the move of the tool centre point along any path, checked along all of it.  Raises MotionError.

    ``sections`` has limits of their own for the ways from mark to mark, if they are not ``limits`` everywhere.
    """
    profile = _path_profile(path, limits, sections)
    if profile.duration_s == 0.0:  # there already: no rounding may make a motion of it
        return Trajectory(arm, kind, start, start, 0.0, lambda _: start, tool=tool)
    tool_inverse = pose_of_frame(tool.inverse())

    def flange_at(fraction: float) -> Pose:
        return flange_of(path.at(fraction), tool_inverse)

    try:
        arm.inverse(flange_at(1.0), near=start)
    except ArmError as error:
        raise as_motion_error(error) from error
    steps = steps_for(profile.duration_s, path.length_mm, path.angle_deg)
    follower = PoseFollower(arm, start, lambda time_s: flange_at(profile.position(time_s)))
    samples = followed(arm, start, profile.duration_s, steps, follower)

    def axes_at(time_s: float) -> Axes:
        if time_s <= 0.0:
            return start
        if time_s >= profile.duration_s:
            return samples[-1]
        share = time_s / profile.duration_s
        near = between(samples, share)
        try:
            return arm.inverse(flange_at(profile.position(time_s)), near=near)
        except ArmError:  # grazes a limit between two checked points: the straight way between them is inside
            return near

    marks_s = tuple(profile.time_at(fraction) for fraction in path.marks)
    return Trajectory(arm, kind, start, samples[-1], profile.duration_s, axes_at, profile.ramp_s, tool, marks_s)


def _path_profile(path: PosePath, limits: PathLimits, sections: Sequence[PathLimits]) -> Trapezoid | SpeedSteps:
    """Return the profile over the fraction of the path that keeps the limits of both position and orientation."""
    shares = [_share_limits(path.length_mm, path.angle_deg, each) for each in (limits, *sections)]
    if shares[0] is None:
        return Trapezoid.fastest(0.0, 1.0, 1.0)
    if all(share == shares[0] for share in shares):
        return Trapezoid.fastest(1.0, *shares[0])
    ends = (*path.marks, 1.0)
    lengths = [end - begin for begin, end in zip((0.0, *path.marks), ends, strict=True)]
    return SpeedSteps.fastest(
        [
            Section(length, *share)
            for length, share in zip(lengths, shares[1:], strict=True)
            if share is not None  # none is: the path has a length or turns
        ]
    )


def _share_limits(length_mm: float, angle_deg: float, limits: PathLimits) -> tuple[float, float] | None:
    """Return speed and acceleration as fractions of the path, None if it has no length and does not turn."""
    for name, value in (
        ("$VEL.CP", limits.speed_m_s),
        ("$ACC.CP", limits.acceleration_m_s2),
        ("$VEL.ORI1", limits.turn_speed_deg_s),
        ("$ACC.ORI1", limits.turn_acceleration_deg_s2),
    ):
        if not value > 0.0:
            raise MotionError(MotionMessage.VALUE, f"{name} invalid: {value:g} is not above 0")
    speeds: list[float] = []
    accelerations: list[float] = []
    if length_mm > 1e-6:
        speeds.append(limits.speed_m_s * 1000.0 / length_mm)
        accelerations.append(limits.acceleration_m_s2 * 1000.0 / length_mm)
    if angle_deg > 1e-6:
        speeds.append(limits.turn_speed_deg_s / angle_deg)
        accelerations.append(limits.turn_acceleration_deg_s2 / angle_deg)
    return (min(speeds), min(accelerations)) if speeds else None


def _check_percent(name: str, percent: float) -> None:
    if not 0.0 < percent <= 100.0:
        raise MotionError(MotionMessage.VALUE, f"{name} of {percent:g} % is not in 0 to 100 %")
