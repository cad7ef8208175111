"""Which trajectory does a spline block mean?  Its segments as one move, with the times and stops of its path."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from slabcell_drivers.krc.messages import KrlError, MotionMessage, RunMessage
from slabcell_drivers.krc.motion import MotionError, Trajectory
from slabcell_drivers.krc.motion_hold import PathStop
from slabcell_drivers.krc.motion_joint_spline import plan_joint_spline
from slabcell_drivers.krc.motion_orders import MoveOrder, PathOrder
from slabcell_drivers.krc.motion_planner import MotionPlanner, Planned
from slabcell_drivers.krc.motion_settings import applied
from slabcell_drivers.krc.motion_spline import SegmentKind, SplineSegment, plan_spline
from slabcell_drivers.krc.motion_timing import EvenSpeed, TimeBlock, retimed, speed_remarks
from slabcell_drivers.krc.values import StructValue
from slabcell_drivers.robot.arm import Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["PathOrders", "plan_block", "stops_of"]

PathOrders = Sequence[tuple[int, PathOrder]]
"""Each with the number of segments that stand before it."""


@dataclass(frozen=True, slots=True)
class _Block:
    planner: MotionPlanner
    start: Axes
    tool: Frame
    base: Frame


def plan_block(
    planner: MotionPlanner, order: MoveOrder, segments: Sequence[MoveOrder], start: Axes, path_orders: PathOrders
) -> Planned:
    """Return the plan of a spline block.  Raises KrlError."""
    tool, base = planner.frame("$TOOL", needed=True), planner.frame("$BASE", needed=True)
    block = _Block(planner, start, tool, base)
    with planner.controller_errors():
        if order.kind == "PTP_SPLINE":
            trajectory = _joint_spline(block, segments, order.sets)
        else:
            planner.check_first(order.kind)
            trajectory = _path_spline(block, segments)
        timed = _time_block(path_orders)
        if timed is not None:
            trajectory = retimed(trajectory, timed)
    planner.needs_axis_motion = False
    remarks: list[tuple[int, str]] = []
    for even in _even_speeds(planner, trajectory, segments, path_orders):
        remarks += speed_remarks(trajectory, even)
    return Planned(trajectory, tool, base, tuple(remarks))


def _path_spline(block: _Block, segments: Sequence[MoveOrder]) -> Trajectory:
    here = block.start
    found: list[SplineSegment] = []
    for segment in segments:
        kind, _, relative = segment.kind.partition("_")
        if kind not in {"SPL", "SLIN", "SCIRC"}:
            raise KrlError(RunMessage.SPLINE_STATEMENT, f"{segment.kind} in a SPLINE block")
        points = [
            block.planner.in_root(segment, p, here, block.tool, block.base, relative=bool(relative))
            for p in segment.points
        ]
        target = points[-1]
        with applied(segment.settings):
            limits = block.planner.limits() if segment.settings else None
            if block.planner.keeps_orientation:
                now = block.planner.arm.forward(here) @ block.tool
                target = Frame(target.x_mm, target.y_mm, target.z_mm, now.a_deg, now.b_deg, now.c_deg)
        found.append(
            SplineSegment(
                SegmentKind(kind),
                target,
                auxiliary=points[0] if len(points) > 1 else None,
                circular_angle_deg=segment.angle_deg,
                limits=limits,
            )
        )
        here = block.planner.arm.inverse(target @ block.tool.inverse(), near=here)
    return plan_spline(block.planner.arm, block.start, found, block.planner.limits(), tool=block.tool)


def _joint_spline(block: _Block, segments: Sequence[MoveOrder], given: frozenset[str]) -> Trajectory:
    targets: list[Axes] = []
    percents: list[tuple[float, float]] = []
    for segment in segments:
        target = segment.points[-1]
        if not segment.kind.startswith("SPTP") or not isinstance(target, StructValue):
            raise KrlError(RunMessage.SPLINE_STATEMENT, f"{segment.kind} in a PTP_SPLINE block")
        here = targets[-1] if targets else block.start
        relative = segment.kind.endswith("_REL")
        targets.append(
            block.planner.axes_of(target, here, block.tool, block.base, relative=relative, reference=segment.reference)
        )
        with applied(segment.settings):
            percents.append(block.planner.percents(given | segment.sets))
    return plan_joint_spline(block.planner.arm, block.start, targets, percents, tool=block.tool)


def _time_block(path_orders: PathOrders) -> TimeBlock | None:
    orders = [(index, order) for index, order in path_orders if order.kind == "TIME_BLOCK"]
    if not orders:
        return None
    if orders[0][1].verb != "START" or orders[-1][1].verb != "END":
        raise MotionError(MotionMessage.TIME, "TIME_BLOCK begins with START and closes with END")
    first, (last, end) = orders[0][0], orders[-1]
    parts = [(index, order.value) for index, order in orders[1:-1]]
    rest = 100.0 - sum(percent for _, percent in parts)
    if last > (parts[-1][0] if parts else first):
        parts.append((last, rest))
    if last <= first or end.value <= 0.0 or any(percent <= 0.0 for _, percent in parts):
        text = f"TIME_BLOCK END={end.value:g}: segments, a time and percentages above 0 are needed, 100 % at most"
        raise MotionError(MotionMessage.TIME, text)
    return TimeBlock(first, tuple(parts), end.value)


def _even_speeds(
    planner: MotionPlanner, trajectory: Trajectory, segments: Sequence[MoveOrder], path_orders: PathOrders
) -> list[EvenSpeed]:
    """Return the ranges of CONST_VEL: from each START, or the start of the block, to the next END, or its end.

    Where the segments of a range have speeds of their own, the lowest holds for the whole range.
    """
    orders = [(index, order) for index, order in path_orders if order.kind == "CONST_VEL"]
    if not orders:
        return []
    speeds: list[float] = []
    for segment in segments:
        with applied(segment.settings):
            speeds.append(planner.limits().speed_m_s)
    times_s = (0.0, *trajectory.marks_s, trajectory.duration_s)
    found: list[EvenSpeed] = []
    begins_s = 0.0
    for index, order in orders:
        time_s = _time_of(planner, trajectory, index, order)
        if order.verb == "START":
            begins_s = time_s
        if order.verb == "END" or order is orders[-1][1]:
            ends_s = max(begins_s, time_s if order.verb == "END" else trajectory.duration_s)
            within = [
                speed
                for speed, (from_s, to_s) in zip(speeds, pairwise(times_s), strict=False)
                if from_s < ends_s and to_s > begins_s
            ]
            found.append(EvenSpeed(begins_s, ends_s, min(within, default=min(speeds))))
    return found


def stops_of(planner: MotionPlanner, trajectory: Trajectory, path_orders: PathOrders) -> list[PathStop]:
    """Return where on a move the arm has to stop, in their order."""
    stops = [
        PathStop(_time_of(planner, trajectory, index, order), order.holds, order.uses_time, order.where)
        for index, order in path_orders
        if order.kind == "STOP" and order.holds is not None
    ]
    return sorted(stops, key=lambda stop: stop.at_s)


def _time_of(planner: MotionPlanner, trajectory: Trajectory, index: int, order: PathOrder) -> float:
    ends_s = (0.0, *trajectory.marks_s, trajectory.duration_s)
    segment = min(index, len(ends_s) - 2)
    reference_s = ends_s[segment] if order.on_start else ends_s[segment + 1]
    return planner.time_along(trajectory, reference_s, order.value)
