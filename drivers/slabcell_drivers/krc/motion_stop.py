"""How does a move stop half way, and go on?  On the path, by slowing its time down: BRAKE, stop and emergency stop."""

from collections.abc import Callable

from slabcell_drivers.krc.motion import MotionKind, Trajectory
from slabcell_drivers.robot.arm import Axes

__all__ = ["resumed", "stopped"]


def stopped(trajectory: Trajectory, at_s: float, *, ramp_s: float) -> tuple[Trajectory, float]:
    """Return the rest of the move from ``at_s`` to a standstill on the path, and how far along the move that is.

    The time of the move slows down evenly to nothing within ``ramp_s`` and passes half of that meanwhile; near its end
    the move just ends.  The second value is a time of ``trajectory``: what `resumed` goes on from.
    """
    at_s = min(max(at_s, 0.0), trajectory.duration_s)
    end_s = min(at_s + ramp_s / 2.0, trajectory.duration_s)

    def axes_at(time_s: float) -> Axes:
        t = min(max(time_s, 0.0), ramp_s)
        passed = t - t * t / (2.0 * ramp_s) if ramp_s > 0.0 else 0.0
        return trajectory.axes_at(min(at_s + passed, end_s))

    return _part(trajectory, trajectory.axes_at(at_s), trajectory.axes_at(end_s), ramp_s, axes_at), end_s


def resumed(trajectory: Trajectory, from_s: float, *, ramp_s: float) -> Trajectory:
    """Return the rest of a move that stands at ``from_s`` of it; it takes up its own pace within ``ramp_s``."""
    from_s = min(max(from_s, 0.0), trajectory.duration_s)

    def axes_at(time_s: float) -> Axes:
        t = max(time_s, 0.0)
        passed = t * t / (2.0 * ramp_s) if t < ramp_s else t - ramp_s / 2.0
        return trajectory.axes_at(from_s + passed)

    left_s = trajectory.duration_s - from_s
    duration_s = left_s + ramp_s / 2.0 if left_s >= ramp_s / 2.0 else (2.0 * ramp_s * left_s) ** 0.5
    return _part(trajectory, trajectory.axes_at(from_s), trajectory.end_axes, duration_s, axes_at)


def _part(
    trajectory: Trajectory, start: Axes, end: Axes, duration_s: float, axes_at: Callable[[float], Axes]
) -> Trajectory:
    return Trajectory(
        trajectory.arm, MotionKind.STOPPED, start, end, duration_s, axes_at, trajectory.ramp_s, trajectory.tool
    )
