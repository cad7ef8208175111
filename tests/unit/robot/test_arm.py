import random

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from slabcell_drivers.robot.arm import KR3_R540, KR6_R900, ArmError, ArmFault, ArmModel, Axes, arm_by_name
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

HOME: Axes = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
ARMS = pytest.mark.parametrize("arm", [KR3_R540, KR6_R900], ids=lambda arm: arm.name)


def seeded(seed: int) -> random.Random:
    return random.Random(seed)


def random_axes(arm: ArmModel, rng: random.Random) -> Axes:
    return tuple(rng.uniform(low, high) for low, high in zip(arm.axis_min_deg, arm.axis_max_deg, strict=True))


def round_trip_errors(arm: ArmModel, rng: random.Random, count: int) -> tuple[float, float, int]:
    """Return the worst position error in mm, the worst axis error in degrees, and how often S or T differed."""
    worst_mm = worst_deg = 0.0
    differed = 0
    for _ in range(count):
        axes = random_axes(arm, rng)
        status, turn = arm.status_turn(axes)
        solved = arm.inverse(arm.forward(axes), status=status, turn=turn, near=axes)
        again, flange = arm.forward(solved), arm.forward(axes)
        worst_mm = max(
            worst_mm, *(abs(p - q) for p, q in zip(again.as_tuple()[:3], flange.as_tuple()[:3], strict=True))
        )
        worst_deg = max(worst_deg, *(abs(p - q) for p, q in zip(solved, axes, strict=True)))
        differed += arm.status_turn(solved) != (status, turn)
    return worst_mm, worst_deg, differed


def test_the_published_check_poses_of_the_kr3_come_out() -> None:
    assert KR3_R540.forward((0, 0, 0, 0, 0, 0)).as_tuple()[:3] == pytest.approx((615.0, 0.0, 365.0))
    assert KR3_R540.forward(HOME).as_tuple() == pytest.approx((355.0, 0.0, 625.0, 0.0, 90.0, 0.0), abs=1e-9)


@ARMS
@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.slow)])
def test_random_poses_with_status_and_turn_come_back_to_their_axes(arm: ArmModel, count: int) -> None:
    seed = random.SystemRandom().randrange(2**32)
    print(f"seed {seed}")
    worst_mm, worst_deg, differed = round_trip_errors(arm, seeded(seed), count)
    assert worst_mm <= 1e-6
    assert worst_deg <= 1e-4  # near the wrist singularity single axes are ill-conditioned, the pose is not
    assert differed == 0


@ARMS
def test_every_solution_reaches_the_pose_and_keeps_the_limits(arm: ArmModel) -> None:
    rng = seeded(5)
    for _ in range(50):
        flange = arm.forward(random_axes(arm, rng))
        solutions = arm.all_solutions(flange)
        assert solutions
        for axes in solutions:
            assert arm.within_limits(axes)
            assert np.abs(arm.forward(axes).matrix - flange.matrix).max() < 1e-9


def test_a_home_position_with_a5_at_zero_is_solved_and_a4_stays() -> None:
    assert KR3_R540.inverse(KR3_R540.forward(HOME), near=HOME) == pytest.approx(HOME, abs=1e-9)
    twisted = (10.0, -80.0, 95.0, 35.0, 0.0, -20.0)
    assert KR3_R540.inverse(KR3_R540.forward(twisted), near=twisted) == pytest.approx(twisted, abs=1e-6)


def test_a_wrist_on_the_a1_axis_keeps_a1() -> None:
    # A2 and A3 that bring the wrist point over the A1 axis
    flange = Frame(0.0, 0.0, 345.0 + 300.0 + 75.0)
    axes = KR3_R540.inverse(flange, near=(25.0, -90.0, 90.0, 0.0, 0.0, 0.0))
    assert axes[0] == pytest.approx(25.0)
    assert np.abs(KR3_R540.forward(axes).matrix - flange.matrix).max() < 1e-9


def test_the_stretched_arm_is_still_reachable_and_a_micrometre_further_is_not() -> None:
    reach = 20.0 + 260.0 + np.hypot(260.0, 20.0) + 75.0
    assert KR3_R540.reachable(Frame(reach - 1e-9, 0.0, 345.0, 0.0, 90.0, 0.0))
    with pytest.raises(ArmError, match=r"out of reach: the wrist would be 520\.8 mm") as caught:
        KR3_R540.inverse(Frame(reach + 1e-3, 0.0, 345.0, 0.0, 90.0, 0.0))
    assert caught.value.fault is ArmFault.UNREACHABLE


def test_an_axis_limit_names_axis_value_and_limit() -> None:
    behind = (0.0, 45.0, -60.0, 0.0, -110.0, 0.0)
    beyond = KR3_R540.forward((0.0, 45.0, -60.0, 0.0, -125.0, 0.0))
    assert KR3_R540.inverse(KR3_R540.forward(behind), near=behind)
    with pytest.raises(ArmError, match="A5") as caught:
        KR3_R540.inverse(beyond, status=KR3_R540.status_turn((0.0, 45.0, -60.0, 0.0, -125.0, 0.0))[0])
    assert (caught.value.fault, caught.value.axis, caught.value.limit_deg) == (ArmFault.AXIS_LIMIT, 5, -120.0)
    assert caught.value.value_deg == pytest.approx(-125.0)


def test_turn_chooses_between_whole_turns_of_a6() -> None:
    flange = KR3_R540.forward((0.0, -60.0, 90.0, 10.0, 30.0, 100.0))
    plus = KR3_R540.inverse(flange, status=2, turn=0b000010)
    minus = KR3_R540.inverse(flange, status=2, turn=0b100010)
    assert (plus[5], minus[5]) == (pytest.approx(100.0), pytest.approx(-260.0))


def test_a_turn_that_would_pass_a_limit_is_refused_and_within_two_degrees_of_zero_disregarded() -> None:
    flange = KR3_R540.forward((30.0, -60.0, 90.0, 10.0, 30.0, 100.0))
    with pytest.raises(ArmError, match="A1 at -330"):
        KR3_R540.inverse(flange, status=2, turn=0b000011)
    near_zero = KR3_R540.forward((1.5, -60.0, 90.0, 10.0, 30.0, 100.0))
    assert KR3_R540.inverse(near_zero, status=2, turn=0b000011)[0] == pytest.approx(1.5)


def test_status_bits_tell_the_eight_configurations_apart() -> None:
    flange = KR3_R540.forward((10.0, -100.0, 60.0, 20.0, 30.0, 40.0))
    solutions = KR3_R540.all_solutions(flange)
    by_status = {KR3_R540.status_turn(axes)[0] for axes in solutions}
    assert len(by_status) >= 4
    for status in by_status:
        assert KR3_R540.status_turn(KR3_R540.inverse(flange, status=status))[0] == status


def test_without_status_the_quickest_configuration_is_taken() -> None:
    near = (10.0, -60.0, 80.0, 20.0, 30.0, 40.0)
    assert KR3_R540.inverse(KR3_R540.forward(near), near=near) == pytest.approx(near)


def test_an_independent_solver_agrees() -> None:
    opw = pytest.importorskip("py_opw_kinematics")
    flips = (True, False, False, True, False, True)
    model = opw.KinematicModel(
        a1=20, a2=-20, b=0, c1=345, c2=260, c3=260, c4=75, offsets=(0, -90, 0, 0, 0, 0), flip_axes=flips
    )
    peer = opw.Robot(model)
    rng = seeded(7)
    for _ in range(100):
        axes = random_axes(KR3_R540, rng)
        flange = KR3_R540.forward(axes)
        assert np.abs(peer.forward(axes).as_matrix() - flange.matrix).max() < 1e-9
        theirs = list(peer.inverse(RigidTransform.from_matrix(flange.matrix)))
        for mine in KR3_R540.all_solutions(flange):
            difference = min(np.abs((np.subtract(q, mine) + 180.0) % 360.0 - 180.0).max() for q in theirs)
            assert difference < 1e-4


def test_vertical_poses_over_the_reference_cell_are_reachable_at_any_rotation_and_away_from_the_singularity() -> None:
    tool = Frame(z_mm=260.0)
    for x in (180.0, 300.0, 430.0):
        for y in (-280.0, 0.0, 280.0):
            for z in (0.0, 60.0, 120.0):
                for a in range(-180, 180, 45):
                    axes = KR3_R540.inverse(Frame(x, y, z, a, 0.0, 180.0) @ tool.inverse(), status=2)
                    assert axes[4] > 10.0


def test_arms_are_found_by_name_and_others_are_refused() -> None:
    assert arm_by_name("KR3-R540") is KR3_R540
    assert arm_by_name("kr6r900") is KR6_R900
    with pytest.raises(ValueError, match="known: kr3r540, kr6r900"):
        arm_by_name("kr99")
