"""Can the arm follow this way?  Step by step along it: axis limits, axis speeds, wrist singularity."""

from collections.abc import Callable
from typing import Protocol

from slabcell_drivers.krc.messages import MotionMessage
from slabcell_drivers.krc.motion_error import MotionError, as_motion_error, singular
from slabcell_drivers.krc.unconfirmed import SINGULAR_A5_DEG
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.arm_solve import Pose

__all__ = ["Follower", "PoseFollower", "between", "followed", "steps_for"]

SHORTEST_CHECK_S = 0.004  # a third of an interpolation tick: no speed peak hides between two checks
CHECK_EVERY_MM = 1.0
CHECK_EVERY_DEG = 0.5
SPEED_TOLERANCE = 1.02  # a difference over one step is not exactly the speed
NO_MOTION_DEG = 1e-6


class Follower(Protocol):
    """Knows where the axes have to be on a way."""

    def solve(self, time_s: float, near: Axes) -> Axes:
        """Return the axes at a time, nearest to those just before.  Raises MotionError."""
        ...

    def accept(self, axes: Axes) -> None:
        """Take note that the arm got there.  Raises MotionError."""
        ...


def steps_for(duration_s: float, length_mm: float, angle_deg: float) -> int:
    """Return how many steps a way is first looked at in."""
    by_way = max(length_mm / CHECK_EVERY_MM, angle_deg / CHECK_EVERY_DEG)
    return max(1, round(min(duration_s / SHORTEST_CHECK_S, by_way)))


def followed(arm: ArmModel, start: Axes, duration_s: float, steps: int, follower: Follower) -> list[Axes]:
    """Return the axes at evenly spaced times from start to end.  Raises MotionError where the arm cannot follow.

    Where an axis moves much within a step, the step is looked at in parts.
    """
    samples = [start]
    for step in range(steps):
        begin, end = duration_s * step / steps, duration_s * (step + 1) / steps
        samples.append(_advance(arm, samples[-1], begin, end, follower))
    return samples


def _advance(arm: ArmModel, before: Axes, begin_s: float, end_s: float, follower: Follower) -> Axes:
    axes = follower.solve(end_s, before)
    limits = arm.axis_speed_deg_s
    if end_s - begin_s > 1.5 * SHORTEST_CHECK_S and any(
        abs(axes[i] - before[i]) > limits[i] * SHORTEST_CHECK_S / 2.0 for i in range(6)
    ):
        middle_s = (begin_s + end_s) / 2.0
        middle = _advance(arm, before, begin_s, middle_s, follower)
        return _advance(arm, middle, middle_s, end_s, follower)
    _check_step(arm, before, axes, end_s - begin_s)
    follower.accept(axes)
    return axes


def _check_step(arm: ArmModel, before: Axes, axes: Axes, step_s: float) -> None:
    for i in range(6):
        moved, allowed = abs(axes[i] - before[i]), arm.axis_speed_deg_s[i]
        if moved <= allowed * step_s * SPEED_TOLERANCE + NO_MOTION_DEG:
            continue
        if moved > 180.0:  # the way goes on beyond a limit, and a whole turn back would be needed
            raise _limit_on_the_way(arm, i, axes[i] + (360.0 if before[i] > axes[i] else -360.0))
        if abs(axes[4]) < 1.0 and i in {3, 5}:
            raise singular(axes[4])
        text = (
            f"Command velocity A{i + 1}: {moved / step_s:.0f}°/s on the path, {allowed:.0f}°/s allowed; "
            "reduce $VEL.CP or use PTP"
        )
        raise MotionError(MotionMessage.AXIS_SPEED, text)


def _limit_on_the_way(arm: ArmModel, i: int, value_deg: float) -> MotionError:
    limit_deg = arm.axis_max_deg[i] if value_deg > 0.0 else arm.axis_min_deg[i]
    sign = "+" if value_deg > 0.0 else "-"
    text = (
        f"Software limit switch point cannot be reached {sign}A{i + 1}: "
        f"{value_deg:.3f}° on the path, beyond its limit {limit_deg:.3f}°, "
        "turn it back before"
    )
    return MotionError(MotionMessage.AXIS_LIMIT, text)


class PoseFollower:
    """Follows flange poses.  The status is kept; a way may begin or end in the wrist singularity, not lead through."""

    def __init__(self, arm: ArmModel, start: Axes, flange_at: Callable[[float], Pose]) -> None:
        self._arm = arm
        self._flange_at = flange_at
        # a way that begins in the singularity has no status yet: the first step out of it decides
        self._status = None if abs(start[4]) < SINGULAR_A5_DEG else arm.status_turn(start)[0]
        self._entered_at_deg: float | None = None

    def solve(self, time_s: float, near: Axes) -> Axes:
        """Return the axes with the status of the way, or those in the singularity, which has either status."""
        flange = self._flange_at(time_s)
        try:
            return self._arm.inverse(flange, near=near, status=self._status)
        except ArmError as error:
            others = self._arm.all_solutions(flange, near=near)
            if others and abs(others[0][4]) < SINGULAR_A5_DEG:
                return others[0]
            if others and (others[0][4] < 0.0) != (near[4] < 0.0):
                raise singular(others[0][4]) from error
            raise as_motion_error(error) from error

    def accept(self, axes: Axes) -> None:
        """Keep account of the singularity."""
        if abs(axes[4]) < SINGULAR_A5_DEG:
            if self._status is not None:
                self._entered_at_deg, self._status = axes[4], None
        elif self._entered_at_deg is not None:
            raise singular(self._entered_at_deg)
        elif self._status is None:
            self._status = self._arm.status_turn(axes)[0]


def between(samples: list[Axes], share: float) -> Axes:
    """Return the axes at a share (0 to 1) of the time of evenly spaced samples, straight from one to the next."""
    place = share * (len(samples) - 1)
    before = min(int(place), len(samples) - 2)
    part = place - before
    a1, a2, a3, a4, a5, a6 = (p + part * (q - p) for p, q in zip(samples[before], samples[before + 1], strict=True))
    return (a1, a2, a3, a4, a5, a6)
