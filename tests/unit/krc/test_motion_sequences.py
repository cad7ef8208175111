"""Moves that pass into each other, spline blocks, and moves that stop half way."""

import numpy as np
import pytest

from slabcell_drivers.krc.motion import MotionError, PathLimits, Trajectory, plan_lin, plan_ptp
from slabcell_drivers.krc.motion_blend import Approximation, blend
from slabcell_drivers.krc.motion_joint import plan_lin_joint
from slabcell_drivers.krc.motion_spline import SegmentKind, SplineSegment, plan_spline
from slabcell_drivers.krc.motion_stop import resumed, stopped
from slabcell_drivers.robot.arm import KR3_R540, Axes
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

TOOL = Frame(z_mm=260.0)
LIMITS = PathLimits(speed_m_s=0.25, acceleration_m_s2=1.0)


def above(x: float, y: float, z: float = 90.0, a: float = 0.0) -> Frame:
    return Frame(x, y, z, a, 0.0, 180.0)


def axes_above(x: float, y: float, z: float = 90.0) -> Axes:
    return KR3_R540.inverse(above(x, y, z) @ TOOL.inverse(), status=2)


def points(trajectory: Trajectory, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Return times, shape (n,), and positions of the tool centre point, shape (n, 3)."""
    times = np.linspace(0.0, trajectory.duration_s, count)
    return times, np.array([trajectory.tcp_at(t).position for t in times])


def corner() -> tuple[Trajectory, Trajectory]:
    first = plan_lin(KR3_R540, axes_above(280.0, -100.0), above(380.0, -100.0), LIMITS, tool=TOOL)
    return first, plan_lin(KR3_R540, first.end_axes, above(380.0, 50.0), LIMITS, tool=TOOL)


def test_an_approximated_corner_is_rounded_within_its_distance_and_saves_time() -> None:
    first, second = corner()
    joined = blend(first, second, Approximation(distance_mm=20.0))
    times, way = points(joined.trajectory, 600)
    miss = np.linalg.norm(way - (380.0, -100.0, 90.0), axis=1).min()
    assert 0.5 < miss < 20.0
    assert joined.trajectory.duration_s < first.duration_s + second.duration_s
    speed = np.linalg.norm(np.gradient(way, times, axis=0), axis=1)
    assert speed[40:-40].min() > 50.0  # it does not stop
    assert speed.max() < 255.0
    assert joined.trajectory.end_axes == second.end_axes
    assert np.linalg.norm(way[-1] - (380.0, 50.0, 90.0)) < 1e-6


def test_a_smaller_distance_rounds_less_and_none_stops_at_the_point() -> None:
    first, second = corner()
    misses = []
    for distance in (20.0, 5.0, 1.0, 0.0):
        _, way = points(blend(first, second, Approximation(distance_mm=distance)).trajectory, 801)
        misses.append(np.linalg.norm(way - (380.0, -100.0, 90.0), axis=1).min())
    assert misses == sorted(misses, reverse=True)
    assert misses[-1] < 0.1
    assert blend(first, second, Approximation(percent=0.0)).begins_s == first.duration_s


def test_no_point_of_a_rounded_corner_is_farther_from_it_than_asked() -> None:
    first, second = corner()
    joined = blend(first, second, Approximation(distance_mm=5.0))
    leaves = np.array(first.tcp_at(joined.begins_s).position)
    assert np.linalg.norm(leaves - (380.0, -100.0, 90.0)) <= 5.0 + 1e-6


def test_a_ptp_blends_into_a_lin_and_marks_where_the_first_is_done() -> None:
    first = plan_ptp(KR3_R540, (60.0, -90.0, 90.0, 0.0, 90.0, 0.0), axes_above(300.0, 0.0), tool=TOOL)
    second = plan_lin(KR3_R540, first.end_axes, above(300.0, 100.0), LIMITS, tool=TOOL)
    joined = blend(first, second, Approximation(percent=50.0))
    assert joined.begins_s < joined.trajectory.marks_s[0] < joined.ends_s
    assert joined.trajectory.axes_at(joined.trajectory.duration_s) == second.end_axes


def test_an_orientation_distance_limits_the_rounding_too() -> None:
    first = plan_lin(KR3_R540, axes_above(300.0, 0.0), above(300.0, 0.0, a=90.0), LIMITS, tool=TOOL)
    second = plan_lin(KR3_R540, first.end_axes, above(300.0, 60.0, a=90.0), LIMITS, tool=TOOL)
    wide = blend(first, second, Approximation(angle_deg=90.0))
    tight = blend(first, second, Approximation(angle_deg=0.5))
    assert wide.begins_s < tight.begins_s < first.duration_s


def test_a_spline_passes_every_point_without_stopping_and_in_order() -> None:
    targets = [above(300.0, -100.0), above(350.0, -50.0), above(300.0, 0.0), above(300.0, 60.0, 60.0)]
    segments = [SplineSegment(SegmentKind.SPL, target) for target in targets]
    move = plan_spline(KR3_R540, axes_above(280.0, -150.0), segments, LIMITS, tool=TOOL)
    assert len(move.marks_s) == 3
    for target, time_s in zip(targets, (*move.marks_s, move.duration_s), strict=True):
        assert np.linalg.norm(np.subtract(move.tcp_at(time_s).position, target.as_tuple()[:3])) < 1e-3
    times, way = points(move)
    speed = np.linalg.norm(np.gradient(way, times, axis=0), axis=1)
    inner = slice(60, 140)
    assert speed[inner].min() > 240.0
    direction = np.gradient(way, times, axis=0)[inner] / speed[inner, None]
    assert np.einsum("ij,ij->i", direction[1:], direction[:-1]).min() > 0.98  # no corner


def test_lines_and_circles_in_a_spline_block_are_exact() -> None:
    segments = [
        SplineSegment(SegmentKind.SLIN, above(300.0, -50.0)),
        SplineSegment(SegmentKind.SCIRC, above(300.0, 50.0), auxiliary=above(350.0, 0.0)),
        SplineSegment(SegmentKind.SLIN, above(300.0, 120.0)),
    ]
    move = plan_spline(KR3_R540, axes_above(300.0, -120.0), segments, LIMITS, tool=TOOL)
    for t in np.linspace(0.0, move.marks_s[0], 20):
        assert move.tcp_at(t).position[0] == pytest.approx(300.0, abs=1e-6)
    for t in np.linspace(*move.marks_s, 20):
        assert np.linalg.norm(np.subtract(move.tcp_at(t).position, (300.0, 0.0, 90.0))) == pytest.approx(50.0)


def test_an_empty_block_and_a_circle_without_auxiliary_point_are_refused() -> None:
    with pytest.raises(MotionError, match="at least one segment"):
        plan_spline(KR3_R540, axes_above(300.0, 0.0), [], LIMITS, tool=TOOL)
    segments = [SplineSegment(SegmentKind.SCIRC, above(300.0, 50.0))]
    with pytest.raises(MotionError, match="auxiliary"):
        plan_spline(KR3_R540, axes_above(300.0, 0.0), segments, LIMITS, tool=TOOL)


def test_a_turn_alone_inside_a_block_keeps_the_turning_speed() -> None:
    segments = [
        SplineSegment(SegmentKind.SLIN, above(300.0, 60.0)),
        SplineSegment(SegmentKind.SLIN, above(300.0, 60.0, a=90.0)),
    ]
    limits = PathLimits(0.25, 1.0, turn_speed_deg_s=90.0, turn_acceleration_deg_s2=900.0)
    move = plan_spline(KR3_R540, axes_above(300.0, 0.0), segments, limits, tool=TOOL)
    assert move.duration_s - move.marks_s[0] >= 1.0


def test_a_stopped_move_stays_on_its_path_and_goes_on_from_there() -> None:
    first, _ = corner()
    braking, stands_at = stopped(first, 0.3, ramp_s=0.1)
    assert stands_at == pytest.approx(0.35)
    assert braking.axes_at(0.0) == first.axes_at(0.3)
    assert braking.end_axes == first.axes_at(stands_at)
    _, way = points(braking, 100)
    assert np.abs(way[:, 1] + 100.0).max() < 1e-6
    assert (np.diff(way[:, 0]) >= -1e-9).all()
    rest = resumed(first, stands_at, ramp_s=0.1)
    assert rest.axes_at(0.0) == pytest.approx(braking.end_axes)
    assert rest.axes_at(rest.duration_s) == pytest.approx(first.end_axes)
    assert rest.duration_s == pytest.approx(first.duration_s - stands_at + 0.05)


def test_a_stop_near_the_end_of_a_move_just_ends_it() -> None:
    first, _ = corner()
    braking, stands_at = stopped(first, first.duration_s - 0.01, ramp_s=0.2)
    assert stands_at == first.duration_s
    assert braking.end_axes == first.end_axes
    rest = resumed(first, first.duration_s - 0.01, ramp_s=0.2)
    assert rest.axes_at(rest.duration_s) == pytest.approx(first.end_axes)


def test_with_the_wrist_turning_axis_by_axis_a_line_passes_the_singularity() -> None:
    start = KR3_R540.inverse(Frame(170.0, 60.0, 190.0, 0.0, 0.0, 180.0), status=6)
    goal = Frame(270.0, 60.0, 190.0, 0.0, 0.0, 180.0)
    with pytest.raises(MotionError, match="Singularity"):
        plan_lin(KR3_R540, start, goal, LIMITS)
    move = plan_lin_joint(KR3_R540, start, goal, LIMITS)
    assert np.abs(move.frame_at(move.duration_s).matrix - goal.matrix).max() < 1e-9
    for t in np.linspace(0.0, move.duration_s, 33):
        x, y, z = move.tcp_at(t).position
        assert (y, z) == (pytest.approx(60.0), pytest.approx(190.0))
        assert 170.0 - 1e-6 <= x <= 270.0 + 1e-6
    a5 = [move.axes_at(t)[4] for t in np.linspace(0.0, move.duration_s, 9)]
    assert a5[0] < 0.0 < a5[-1]
    assert np.diff(a5).min() > 0.0


def test_axis_by_axis_the_tool_centre_point_of_a_crooked_tool_stays_on_its_line() -> None:
    tool = Frame(40.0, -30.0, 120.0, 10.0, 20.0, 30.0)
    start: Axes = (20.0, -60.0, 90.0, 30.0, 40.0, 50.0)
    first = KR3_R540.forward(start) @ tool
    goal = Frame(first.x_mm - 60.0, first.y_mm + 80.0, first.z_mm + 40.0, first.a_deg + 25.0, first.b_deg, first.c_deg)
    move = plan_lin_joint(KR3_R540, start, goal, LIMITS, tool=tool)
    begin, end = (np.array(frame.as_tuple()[:3]) for frame in (first, goal))
    direction = (end - begin) / np.linalg.norm(end - begin)
    for t in np.linspace(0.0, move.duration_s, 33):
        way = np.array(move.tcp_at(t).position) - begin
        assert np.linalg.norm(way - direction * (way @ direction)) < 1e-6
    assert np.abs((move.frame_at(move.duration_s) @ tool).matrix - goal.matrix).max() < 1e-9


def test_axis_by_axis_a_line_that_is_too_fast_or_out_of_reach_is_refused() -> None:
    with pytest.raises(MotionError, match="Work envelope exceeded"):
        plan_lin_joint(KR3_R540, axes_above(300.0, 0.0), above(600.0, 0.0), LIMITS, tool=TOOL)
    near = KR3_R540.inverse(Frame(60.0, 250.0, 600.0, 0.0, 0.0, 180.0), near=(0.0, -90.0, 90.0, 0.0, 0.0, 0.0))
    with pytest.raises(MotionError, match="Command velocity A1"):
        plan_lin_joint(KR3_R540, near, Frame(60.0, -250.0, 600.0, 0.0, 0.0, 180.0), PathLimits(2.0, 20.0))
