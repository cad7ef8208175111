import math

import numpy as np
import pytest

from slabcell_drivers.krc.messages import MotionMessage
from slabcell_drivers.krc.motion import MotionError, PathLimits, plan_circ, plan_lin, plan_ptp
from slabcell_drivers.krc.motion_path import Turning, quaternion_of, rotation_of
from slabcell_drivers.krc.motion_profile import Trapezoid
from slabcell_drivers.robot.arm import KR3_R540, Axes
from slabcell_drivers.robot.arm_solve import pose_of_frame
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

TOOL = Frame(z_mm=260.0)
PHOTO: Axes = (120.0, -90.0, 90.0, 0.0, 90.0, 0.0)
HOME: Axes = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
SLOW = PathLimits(speed_m_s=0.25)


def above(x: float, y: float, z: float = 90.0, a: float = 0.0) -> Frame:
    return Frame(x, y, z, a, 0.0, 180.0)


def axes_above(x: float, y: float, z: float = 90.0, a: float = 0.0) -> Axes:
    return KR3_R540.inverse(above(x, y, z, a) @ TOOL.inverse(), status=2)


def tcp_at(trajectory, time_s: float) -> np.ndarray:
    return (trajectory.frame_at(time_s) @ TOOL).matrix


def test_a_profile_covers_its_distance_within_speed_and_acceleration() -> None:
    for distance, speed, acceleration in ((100.0, 50.0, 200.0), (1.0, 50.0, 200.0)):
        profile = Trapezoid.fastest(distance, speed, acceleration)
        times = np.linspace(0.0, profile.duration_s, 2001)
        covered = np.array([profile.position(t) for t in times])
        velocity = np.gradient(covered, times)
        assert covered[0] == 0.0
        assert covered[-1] == distance
        assert velocity.max() <= speed * 1.001
        assert np.abs(np.gradient(velocity, times)).max() <= acceleration * 1.01
        for t in times[1:-1:200]:
            assert profile.time_at(profile.position(t)) == pytest.approx(t)


def test_a_profile_without_speed_is_refused() -> None:
    with pytest.raises(ValueError, match="above 0"):
        Trapezoid.fastest(1.0, 0.0, 1.0)


def test_the_axes_of_a_ptp_run_in_step_and_the_slowest_reaches_its_limit() -> None:
    target = (-150.0, -60.0, 100.0, 0.0, 50.0, 200.0)
    move = plan_ptp(KR3_R540, PHOTO, target)
    times = np.linspace(0.0, move.duration_s, 500)
    way = np.array([move.axes_at(t) for t in times])
    fraction = (way - PHOTO) / np.where(np.subtract(target, PHOTO) == 0.0, 1.0, np.subtract(target, PHOTO))
    moving = np.subtract(target, PHOTO) != 0.0
    assert np.ptp(fraction[:, moving], axis=1).max() < 1e-9
    peak = np.abs(np.gradient(way, times, axis=0)).max(axis=0) / KR3_R540.axis_speed_deg_s
    assert 0.99 < peak.max() < 1.001
    assert move.axes_at(-1.0) == PHOTO
    assert move.axes_at(move.duration_s + 1.0) == target


def test_half_the_velocity_takes_a_ptp_longer_and_no_way_takes_no_time() -> None:
    target = (-150.0, -60.0, 100.0, 0.0, 50.0, 200.0)
    full, half = plan_ptp(KR3_R540, PHOTO, target), plan_ptp(KR3_R540, PHOTO, target, speed_percent=50.0)
    assert 1.5 < half.duration_s / full.duration_s <= 2.0
    assert plan_ptp(KR3_R540, PHOTO, PHOTO).duration_s == 0.0


@pytest.mark.parametrize("percent", [0.0, -1.0, 100.1, math.nan])
def test_a_velocity_outside_0_to_100_percent_is_refused(percent: float) -> None:
    with pytest.raises(MotionError, match="velocity") as caught:
        plan_ptp(KR3_R540, PHOTO, HOME, speed_percent=percent)
    assert caught.value.number == MotionMessage.VALUE


def test_a_ptp_beyond_a_limit_names_axis_value_and_limit() -> None:
    with pytest.raises(
        MotionError,
        match=r"Software limit switch .* \+A5.*125\.000° is beyond its limit of 120\.000°",
    ):
        plan_ptp(KR3_R540, HOME, (0.0, -90.0, 90.0, 0.0, 125.0, 0.0))


def test_the_tool_centre_point_of_a_lin_stays_on_the_line_while_the_tool_turns() -> None:
    start = axes_above(300.0, -200.0, 90.0, 30.0)
    goal = above(320.0, 180.0, 10.0, -80.0)
    move = plan_lin(KR3_R540, start, goal, SLOW, tool=TOOL)
    first, last = tcp_at(move, 0.0)[:3, 3], goal.matrix[:3, 3]
    direction = (last - first) / np.linalg.norm(last - first)
    for t in np.linspace(0.0, move.duration_s, 57):
        point = tcp_at(move, t)[:3, 3] - first
        assert np.linalg.norm(point - direction * (point @ direction)) < 1e-6
        assert tcp_at(move, t)[2, 2] == pytest.approx(-1.0)
    assert np.abs(tcp_at(move, move.duration_s) - goal.matrix).max() < 1e-6
    assert KR3_R540.status_turn(move.end_axes)[0] == KR3_R540.status_turn(start)[0]


def test_a_lin_keeps_path_speed_and_acceleration() -> None:
    move = plan_lin(KR3_R540, axes_above(300.0, -200.0), above(300.0, 150.0), SLOW, tool=TOOL)
    times = np.linspace(0.0, move.duration_s, 400)
    speed = np.linalg.norm(np.gradient([tcp_at(move, t)[:3, 3] for t in times], times, axis=0), axis=1)
    assert speed.max() == pytest.approx(250.0, rel=0.01)
    assert move.duration_s == pytest.approx(350.0 / 250.0 + 250.0 / 2300.0)


def test_a_lin_that_only_turns_the_tool_keeps_the_turning_speed() -> None:
    limits = PathLimits(turn_speed_deg_s=90.0, turn_acceleration_deg_s2=900.0)
    move = plan_lin(KR3_R540, axes_above(300.0, 0.0), above(300.0, 0.0, a=90.0), limits, tool=TOOL)
    assert move.duration_s == pytest.approx(1.0 + 0.1)
    for t in np.linspace(0.0, move.duration_s, 9):
        assert np.linalg.norm(tcp_at(move, t)[:3, 3] - (300.0, 0.0, 90.0)) < 1e-6


def test_a_lin_out_of_reach_is_refused() -> None:
    with pytest.raises(MotionError, match="Work envelope exceeded") as caught:
        plan_lin(KR3_R540, axes_above(300.0, 0.0), above(600.0, 0.0), SLOW, tool=TOOL)
    assert caught.value.number == MotionMessage.UNREACHABLE


def test_a_lin_through_the_wrist_singularity_is_refused() -> None:
    # with the flange this low the wrist passes below the elbow: A5 changes its sign
    start = KR3_R540.inverse(Frame(170.0, 60.0, 190.0, 0.0, 0.0, 180.0), status=6)
    with pytest.raises(MotionError, match="Singularity: A5") as caught:
        plan_lin(KR3_R540, start, Frame(270.0, 60.0, 190.0, 0.0, 0.0, 180.0), SLOW)
    assert caught.value.number == MotionMessage.SINGULARITY


def test_a_lin_may_leave_a_home_position_with_a5_at_zero_and_come_back() -> None:
    down = plan_lin(KR3_R540, HOME, Frame(355.0, 0.0, 500.0, 0.0, 90.0, 0.0), SLOW)
    back = plan_lin(KR3_R540, down.end_axes, KR3_R540.forward(HOME), SLOW)
    assert back.end_axes == pytest.approx(HOME, abs=1e-4)


def test_a_lin_that_turns_the_tool_beyond_a_limit_names_the_limit_and_not_the_speed() -> None:
    start = KR3_R540.inverse(above(300.0, 0.0) @ TOOL.inverse(), status=2, turn=0b000010)
    move = plan_lin(KR3_R540, start, above(300.0, 0.0, a=120.0), SLOW, tool=TOOL)
    assert move.end_axes[5] == pytest.approx(300.0)
    with pytest.raises(MotionError, match=r"Software limit switch .* \+A6: 35\d\.\d+° on the path") as caught:
        plan_lin(KR3_R540, move.end_axes, above(300.0, 0.0, a=-120.0), SLOW, tool=TOOL)
    assert caught.value.number == MotionMessage.AXIS_LIMIT


def test_a_lin_too_fast_for_an_axis_is_refused() -> None:
    near = KR3_R540.inverse(Frame(60.0, 250.0, 600.0, 0.0, 0.0, 180.0), near=HOME)
    beyond = Frame(60.0, -250.0, 600.0, 0.0, 0.0, 180.0)
    with pytest.raises(MotionError, match=r"Command velocity A\d: \d+°/s on the path"):
        plan_lin(KR3_R540, near, beyond, PathLimits(speed_m_s=2.0, acceleration_m_s2=20.0))


def test_a_circ_passes_the_auxiliary_point_and_ends_at_the_target() -> None:
    start, aux, goal = axes_above(300.0, -100.0), above(350.0, -50.0), above(300.0, 0.0)
    move = plan_circ(KR3_R540, start, aux, goal, SLOW, tool=TOOL)
    points = np.array([tcp_at(move, t)[:3, 3] for t in np.linspace(0.0, move.duration_s, 101)])
    assert np.abs(np.linalg.norm(points - (300.0, -50.0, 90.0), axis=1) - 50.0).max() < 1e-6
    assert np.linalg.norm(points[50] - (350.0, -50.0, 90.0)) < 1e-3
    assert np.linalg.norm(points[-1] - (300.0, 0.0, 90.0)) < 1e-6


def test_a_circular_angle_goes_on_beyond_the_target() -> None:
    start, aux, goal = axes_above(300.0, -100.0), above(350.0, -50.0), above(300.0, 0.0)
    move = plan_circ(KR3_R540, start, aux, goal, SLOW, tool=TOOL, circular_angle_deg=270.0)
    assert tcp_at(move, move.duration_s)[:3, 3] == pytest.approx((250.0, -50.0, 90.0), abs=1e-6)


def test_three_points_on_a_line_are_no_circle() -> None:
    with pytest.raises(MotionError, match="one line") as caught:
        plan_circ(KR3_R540, axes_above(300.0, -100.0), above(300.0, -50.0), above(300.0, 0.0), SLOW, tool=TOOL)
    assert caught.value.number == MotionMessage.CIRCLE


def test_a_path_without_speed_is_refused() -> None:
    with pytest.raises(MotionError, match=r"\$VEL\.CP"):
        plan_lin(KR3_R540, axes_above(300.0, 0.0), above(300.0, 50.0), PathLimits(speed_m_s=0.0), tool=TOOL)


def test_an_orientation_turns_the_shorter_way_and_survives_the_way_there_and_back() -> None:
    for frame in (Frame(a_deg=170.0, c_deg=180.0), Frame(b_deg=90.0), Frame(a_deg=-30.0, b_deg=40.0, c_deg=-170.0)):
        rotation = pose_of_frame(frame).rotation
        assert np.abs(np.subtract(rotation_of(quaternion_of(rotation)), rotation)).max() < 1e-12
    q1, q2 = (quaternion_of(pose_of_frame(Frame(a_deg=a)).rotation) for a in (170.0, -170.0))
    assert Turning.between(q1, q2).angle_deg == pytest.approx(20.0)
