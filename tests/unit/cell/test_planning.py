"""Does planning hand out only poses that the arm reaches, and say why not?"""

from dataclasses import replace

import numpy as np
import pytest

from slabcell.catalogue import Fault
from slabcell.cell.planning import Planner
from slabcell.cell.records import Pair
from slabcell.cell.settings import CellSettings
from slabcell.errors import ConfigurationError
from slabcell.geometry import PlanarPose, Polygon, RigidTransform2D, normalize_deg
from slabcell.recipe import Recipe
from slabcell.template import Template
from slabcell.vision.result import ImagePose, LocatedPart, Sigma
from slabcell_drivers.robot.arm import KR3_R540, ArmError
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.native import native_library

pytestmark = pytest.mark.unit

WIDE = Polygon.from_points([(-2000, -2000), (2000, -2000), (2000, 2000), (-2000, 2000)])
SETTINGS = CellSettings(Frame(200, -200), Frame(220, 100, 0, 5), Frame(z_mm=260), WIDE)


def square(x: float, y: float, side: float = 30.0) -> Polygon:
    return Polygon.from_points([(x, y), (x + side, y), (x + side, y + side), (x, y + side)])


def part(slot: int = 0, pick=(50.0, 40.0, 0.0), place=(15.0, 15.0), order: int = 1):
    return LocatedPart(
        *(slot, 0.9, 0.1, order, ImagePose(0, 0, 0), RigidTransform2D(0, 0, 0)),
        *(PlanarPose(*pick), PlanarPose(*place, 0.0), Sigma(0, 0, 0), np.zeros((0, 2))),
    )


def plan(parts, settings=SETTINGS, *, slots=None, laid=(), thickness_mm=10.0, other=None):
    slots = slots or [square(100.0 * index, 0) for index in range(1 + max(item.slot for item in parts))]
    recipe = Recipe.from_template(Template("squares", tuple(slots), "0" * 64), thickness_mm)
    recipe = replace(recipe, other_thickness_mm=other or {})
    return Planner(recipe, settings, KR3_R540).plan(parts, laid=laid)


def flange(settings, base, pose, lift_mm=0.0):
    above = Frame(*pose.as_tuple()[:2], pose.z_mm + lift_mm, *pose.as_tuple()[3:])
    return base @ above @ settings.tool.inverse()


def scattered(number: int, seed: int = 3):
    rng = np.random.default_rng(seed)
    return [part(i, tuple(rng.uniform(-100, 300, 3)), tuple(rng.uniform(-100, 300, 2))) for i in range(number)]


def test_both_poses_keep_the_rotation_that_the_part_needs():
    (pair,) = plan([part(pick=(50, 40, 37.0))], thickness_mm=12.0).pairs
    assert (pair.place.a_deg - pair.pick.a_deg + 37.0) % 360 == pytest.approx(0, abs=1e-9)
    assert (pair.pick.z_mm, pair.place.z_mm) == (12.0, 12.0)
    assert pair.pick.as_tuple()[4:] == pair.place.as_tuple()[4:] == (0.0, 180.0)


@pytest.mark.parametrize(
    "tool", [Frame(z_mm=260), Frame(z_mm=260, a_deg=40), Frame(15, 0, 240), Frame(0, 0, 250, 0, 5)]
)
def test_the_arm_reaches_every_planned_pose_from_above_in_one_configuration(tool):
    settings = replace(SETTINGS, tool=tool)
    outcome = plan(scattered(40), settings)
    assert outcome.pairs
    assert outcome.refused
    assert sorted([p.slot for p in outcome.pairs] + [r.slot for r in outcome.refused]) == list(range(40))
    for pair in outcome.pairs:
        for base, pose in ((settings.pick_base, pair.pick), (settings.place_base, pair.place)):
            above = KR3_R540.inverse(flange(settings, base, pose, settings.approach_mm))
            at = KR3_R540.inverse(flange(settings, base, pose), near=above, status=KR3_R540.status_turn(above)[0])
            assert np.allclose((KR3_R540.forward(at) @ tool).matrix, (base @ pose).matrix, atol=1e-6)


class Asked:
    """An arm that notes which configurations it is asked for."""

    def __init__(self, arm):
        self.arm, self.statuses = arm, []

    def __getattr__(self, name):
        return getattr(self.arm, name)

    def inverse(self, pose, **known):
        self.statuses.append(known.get("status"))
        return self.arm.inverse(pose, **known)


@pytest.fixture(params=["compiled", "in Python"])
def engine(request, monkeypatch):
    """Plan with the compiled library, and without one."""
    if request.param == "in Python":
        monkeypatch.setattr("slabcell.cell.descent.native_library", lambda: None)
    else:
        assert native_library() is not None, "not compiled: python hatch_build.py"
    return request.param


def test_the_arm_stays_in_the_configuration_that_reaches_the_first_slab(engine):
    arm = Asked(KR3_R540)
    parts = [part(i, (20.0 * i, 30.0 * i, 50.0 * i), (100.0 * i + 15.0, 15.0)) for i in range(3)]
    slots = tuple(square(100.0 * index, 0) for index in range(3))
    recipe = Recipe.from_template(Template("squares", slots, "0" * 64), 10.0)
    assert len(Planner(recipe, SETTINGS, arm).plan(parts).pairs) == 3
    if engine == "in Python":
        assert arm.statuses.pop(0) is None
    assert set(arm.statuses) == {2}


def test_a_slab_that_is_got_down_to_in_a_slower_configuration_only_is_laid(engine):
    pick = (-70.0, -24.0, 169.0)
    down = Frame(*pick[:2], 10.0, pick[2], 0, 180)
    above = KR3_R540.inverse(flange(SETTINGS, SETTINGS.pick_base, down, SETTINGS.approach_mm))
    at, quickest = flange(SETTINGS, SETTINGS.pick_base, down), KR3_R540.status_turn(above)[0]
    with pytest.raises(ArmError):
        KR3_R540.inverse(at, near=above, status=quickest)
    assert plan([part(pick=pick)]).count == 1


def test_with_and_without_the_compiled_library_the_plan_is_the_same(monkeypatch):
    rng = np.random.default_rng(5)
    slots = tuple(square(40.0 * index, 0) for index in range(8))
    recipe = Recipe.from_template(Template("squares", slots, "0" * 64), 10.0)
    compiled = Planner(recipe, SETTINGS, KR3_R540)
    monkeypatch.setattr("slabcell.cell.descent.native_library", lambda: None)
    in_python = Planner(recipe, SETTINGS, KR3_R540)
    refused = 0
    for _ in range(200):
        chosen = rng.permutation(8)[: rng.integers(1, 9)].tolist()
        parts = [part(i, (*rng.uniform(-250, 450, 2), rng.uniform(-180, 180)), (40.0 * i + 15.0, 15.0)) for i in chosen]
        one, other = compiled.plan(parts), in_python.plan(parts)
        assert one.refused == other.refused
        assert one.pairs == other.pairs
        refused += len(one.refused)
    assert 50 < refused < 500


def wrist_travel(settings, pairs):
    """Follow the arm through all poses; return how far A6 has turned."""
    axes, travel = None, 0.0
    for pair in pairs:
        for base, pose in ((settings.pick_base, pair.pick), (settings.place_base, pair.place)):
            options = KR3_R540.all_solutions(flange(settings, base, pose))
            options = [o for o in options if KR3_R540.status_turn(o)[0] == 2]
            after = min(options, key=lambda o: abs(o[5] - axes[5]) if axes else abs(o[5]))
            travel += abs(after[5] - axes[5]) if axes else 0.0
            axes = after
    return travel


def test_the_wrist_turns_less_than_with_the_tool_along_the_part():
    parts = scattered(30)
    planned = plan(parts).pairs
    by_slot = {item.slot: item for item in parts}
    plain = [
        Pair(
            pair.slot,
            Frame(
                by_slot[pair.slot].pick.x_mm, by_slot[pair.slot].pick.y_mm, 10, by_slot[pair.slot].pick.a_deg, 0, 180
            ),
            Frame(by_slot[pair.slot].place.x_mm, by_slot[pair.slot].place.y_mm, 10, 0, 0, 180),
            0.9,
        )
        for pair in planned
    ]
    assert wrist_travel(SETTINGS, planned) < 0.7 * wrist_travel(SETTINGS, plain)


def test_a_part_that_looks_alike_after_a_turn_is_laid_as_it_lies():
    slot = square(0, 0)
    one_way = plan([part(pick=(50, 40, 170), place=(10.0, 12.0))], slots=[slot]).pairs[0]
    any_way = plan([part(pick=(50, 40, 170), place=(10.0, 12.0), order=4)], slots=[slot]).pairs[0]
    assert wrist_travel(SETTINGS, [any_way]) < wrist_travel(SETTINGS, [one_way])
    # The slab covers the same place whichever way it is laid: its motion takes the slot onto itself.
    turn = normalize_deg(any_way.place.a_deg - any_way.pick.a_deg + 170)
    motion = RigidTransform2D(turn, 0, 0)
    x, y = np.array([any_way.place.x_mm, any_way.place.y_mm]) - motion.apply(np.array([10.0, 12.0]))
    moved = slot.transformed(RigidTransform2D(turn, x, y))
    assert moved.shape.symmetric_difference(slot.shape).area < 1e-6


@pytest.mark.parametrize(
    ("pick", "place", "end"), [((900, 0, 0), (20, 20), "pick: "), ((50, 40, 0), (900, 0), "place: ")]
)
def test_what_is_out_of_reach_is_refused_with_the_distance(pick, place, end):
    (refused,) = plan([part(pick=pick, place=place)]).refused
    assert refused.fault is Fault.UNREACHABLE
    assert "mm from the A2 axis" in refused.detail
    assert refused.detail.startswith(end)


def test_a_grasp_point_outside_of_the_pick_area_is_refused():
    small = Polygon.from_points([(0, 0), (10, 0), (10, 10), (0, 10)])
    (refused,) = plan([part()], replace(SETTINGS, pick_area=small)).refused
    assert refused.fault is Fault.OUTSIDE_WORKSPACE
    assert "X 50.0 Y 40.0" in refused.detail


def test_neither_tool_nor_slab_is_lowered_into_a_forbidden_zone():
    at_pick, at_place = square(55, 30, 5), square(20, 325, 5)
    (refused,) = plan([part()], replace(SETTINGS, forbidden=(at_pick,))).refused
    assert (refused.fault, "forbidden zone 1" in refused.detail) == (Fault.OUTSIDE_WORKSPACE, True)
    (refused,) = plan([part()], replace(SETTINGS, forbidden=(square(900, 900), at_place))).refused
    assert (refused.fault, "forbidden zone 2" in refused.detail) == (Fault.COLLISION, True)


def test_the_assembly_in_the_table_follows_from_both_bases():
    point = np.array([[10.0, 20.0]])
    direct = SETTINGS.assembly_in_table.apply(point)[0]
    root = SETTINGS.place_base.matrix @ (10.0, 20.0, 0.0, 1.0)
    through_root = np.linalg.inv(SETTINGS.pick_base.matrix) @ root
    assert direct == pytest.approx(through_root[:2])


def test_bases_that_are_tilted_against_each_other_are_refused():
    with pytest.raises(ConfigurationError, match=r"B 0\.500°"):
        CellSettings(Frame(200, -200), Frame(220, 100, 0, 0, 0.5), Frame(z_mm=260), WIDE)


def beside(slot: int, pick=None):
    """The slab of one of three slots in a row, 30 mm wide, without a joint between them."""
    at = RigidTransform2D(0.0, 100.0 * slot if pick is None else pick - 15.0, 40.0)
    found = part(slot, (at.x_mm + 15.0, 55.0, 0.0), (30.0 * slot + 15.0, 15.0))
    where = at.inverse() @ RigidTransform2D(0.0, 0.0, 0.0)
    return LocatedPart(
        *(slot, 0.9, 0.1, 1, ImagePose(0, 0, 0), RigidTransform2D(0.0, where.x_mm + 30.0 * slot, where.y_mm)),
        *(found.pick, found.place, Sigma(0, 0, 0), np.zeros((0, 2))),
    )


ROW = [square(30.0 * slot, 0.0) for slot in range(3)]
THICK = {1: 25.0}
WIDE_GRIPPER = replace(SETTINGS, gripper_radius_mm=18.0)


def test_each_slab_is_picked_and_laid_at_its_own_height():
    pairs = plan([beside(slot) for slot in range(3)], slots=ROW, other=THICK).pairs
    assert {pair.slot: (pair.pick.z_mm, pair.place.z_mm) for pair in pairs} == {
        0: (10.0, 10.0),
        1: (25.0, 25.0),
        2: (10.0, 10.0),
    }


def test_what_is_lower_is_laid_before_what_is_higher_beside_it():
    planned = plan([beside(slot) for slot in range(3)], WIDE_GRIPPER, slots=ROW, other=THICK)
    assert planned.refused == ()
    order = [pair.slot for pair in planned.pairs]
    assert order.index(1) == 2
    flat = plan([beside(slot) for slot in range(3)], WIDE_GRIPPER, slots=ROW)
    assert [pair.slot for pair in flat.pairs].index(1) < 2  # without heights the middle one comes before it is pinched


def test_a_gripper_that_does_not_reach_beyond_its_slab_need_not_care():
    narrow = replace(SETTINGS, gripper_radius_mm=10.0)
    planned = plan([beside(0)], narrow, slots=ROW, laid=(1,), other=THICK)
    assert [pair.slot for pair in planned.pairs] == [0]


def test_nothing_is_laid_where_the_gripper_would_hit_a_higher_slab_that_lies_there():
    planned = plan([beside(0), beside(2)], WIDE_GRIPPER, slots=ROW, laid=(1,), other=THICK)
    assert planned.pairs == ()
    assert [(item.slot, item.fault) for item in planned.refused] == [(0, Fault.COLLISION), (2, Fault.COLLISION)]
    assert "would hit the slab in slot 1" in planned.refused[0].detail


def test_what_is_higher_waits_for_a_lower_slot_beside_it_that_nothing_fills_yet():
    planned = plan([beside(1), beside(2)], WIDE_GRIPPER, slots=ROW, other=THICK)
    assert [pair.slot for pair in planned.pairs] == [2]
    assert [(item.slot, item.fault) for item in planned.refused] == [(1, Fault.COLLISION)]
    assert "slot 0 beside it is lower" in planned.refused[0].detail


def test_a_part_that_lies_beside_a_higher_one_is_picked_after_it():
    far = [square(0.0, 0.0), square(100.0, 0.0)]
    thin, thick = beside(0, pick=100.0), beside(1, pick=131.0)
    thick = LocatedPart(
        *(1, 0.9, 0.1, 1, ImagePose(0, 0, 0), RigidTransform2D(0.0, 100.0 - 116.0, -40.0)),
        *(thick.pick, PlanarPose(115.0, 15.0, 0.0), Sigma(0, 0, 0), np.zeros((0, 2))),
    )
    planned = plan([thin, thick], WIDE_GRIPPER, slots=far, other=THICK)
    assert [pair.slot for pair in planned.pairs] == [1, 0]
    alone = plan([thin, thick], WIDE_GRIPPER, slots=far)
    assert [pair.slot for pair in alone.pairs] == [0, 1]


def test_parts_that_wait_for_each_other_are_refused():
    # Slot 1 is higher and beside slot 0 in the pattern; on the table the higher one lies beside the lower.
    planned = plan([beside(0, pick=100.0), beside(1, pick=131.0)], WIDE_GRIPPER, slots=ROW[:2], other=THICK)
    assert planned.pairs == ()
    assert {item.fault for item in planned.refused} == {Fault.COLLISION}
    assert "have to go first" in planned.refused[0].detail


def test_an_approach_that_is_not_above_the_highest_slab_is_refused_for_every_part():
    planned = plan([beside(0)], replace(SETTINGS, approach_mm=20.0), slots=ROW, other=THICK)
    assert planned.pairs == ()
    assert "raise robot.krl.approach_mm" in planned.refused[0].detail
