import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from slabcell_drivers.robot import Frame
from slabcell_drivers.simulation import EventKind, GripperFaults, Slab, World, load_scene

pytestmark = pytest.mark.unit

CONFIG = Path(__file__).parents[3] / "config"
DRESDEN = load_scene(CONFIG / "scenes" / "dresden.toml")
SLOTS = [np.array(slab.outline) for slab in DRESDEN.outlines]


def over(slab: Slab, *, dx: float = 0.0, dy: float = 0.0, height: float | None = None, a: float = 0.0) -> Frame:
    """Return a tool that points down at a slab's centre, on its upper face unless a height is given."""
    return Frame(slab.frame.x_mm + dx, slab.frame.y_mm + dy, slab.top_mm if height is None else height, a, 0.0, 180.0)


def test_a_slab_goes_where_the_gripper_carries_it_and_stays_where_it_is_released() -> None:
    world = World(DRESDEN, 1)
    slab = world.slabs[2]
    others = [one.frame for one in world.slabs if one.number != 2]
    pick = over(slab, a=30.0)

    assert world.grip(pick)
    assert world.vacuum
    world.moved(Frame(300.0, 0.0, 90.0, 120.0, 0.0, 180.0))
    carried = world.slabs[2]
    world.release(Frame(310.0, 100.0, 10.0, 120.0, 0.0, 180.0))

    laid = world.slabs[2]
    assert carried.top_mm == pytest.approx(90.0)
    assert not world.vacuum
    assert (laid.frame.x_mm, laid.frame.y_mm, laid.frame.z_mm) == pytest.approx((310.0, 100.0, 0.0))
    assert (laid.frame.a_deg - slab.frame.a_deg) % 360.0 == pytest.approx(90.0)
    assert [one.frame for one in world.slabs if one.number != 2] == others
    assert [event.kind for event in world.events] == [EventKind.GRIPPED, EventKind.RELEASED]
    assert world.pick_counts == (0, 0, 1, 0, 0)


@pytest.mark.parametrize(
    ("tcp", "says"),
    [
        (Frame(z_mm=1.5), "no upper face at 11.50 mm"),
        (Frame(z_mm=-1.5), "no upper face at 8.50 mm"),
        (Frame(c_deg=5.0), "tilted 5.0°"),
        (Frame(b_deg=90.0), "tilted 90.0°"),
        (Frame(x_mm=22.5), "from the rim"),
        (Frame(x_mm=60.0, y_mm=0.0), "nothing is under the cup|from the rim"),
    ],
)
def test_a_grip_that_does_not_sit_well_misses_and_says_why(tcp: Frame, says: str) -> None:
    slab = replace(World(DRESDEN, 1).slabs[2])  # 50 x 50 mm
    world = World(DRESDEN, 1)
    along = np.deg2rad(slab.frame.a_deg)
    pose = over(slab)
    shifted = Frame(
        pose.x_mm + tcp.x_mm * float(np.cos(along)),
        pose.y_mm + tcp.x_mm * float(np.sin(along)),
        pose.z_mm + tcp.z_mm,
        0.0,
        tcp.b_deg,
        180.0 + tcp.c_deg,
    )

    assert not world.grip(shifted)

    assert not world.vacuum
    assert world.slabs[2].frame == slab.frame
    (event,) = world.events
    assert event.kind is EventKind.MISSED
    assert re.search(says, event.detail)


def test_a_cup_just_inside_the_rim_holds_and_just_over_it_does_not() -> None:
    world = World(DRESDEN, 1)
    slab = world.slabs[2]
    along = np.deg2rad(slab.frame.a_deg)

    def at(distance: float) -> Frame:
        return over(slab, dx=distance * float(np.cos(along)), dy=distance * float(np.sin(along)))

    assert not world.grip(at(25.0 - 4.0 + 0.01))
    assert world.grip(at(25.0 - 4.0 - 0.01))


def test_a_slab_released_in_the_air_is_dropped_and_does_not_lie_where_it_was_let_go() -> None:
    world = World(DRESDEN, 1)
    world.grip(over(world.slabs[0]))

    world.release(Frame(280.0, 100.0, 40.0, 0.0, 0.0, 180.0))

    assert world.events[-1].kind is EventKind.DROPPED
    assert world.slabs[0].frame.z_mm == 0.0
    assert np.hypot(world.slabs[0].frame.x_mm - 280.0, world.slabs[0].frame.y_mm - 100.0) > 0.5


def test_a_slab_laid_on_another_lies_on_top_of_it_and_hides_it_from_the_cup() -> None:
    world = World(DRESDEN, 1)
    below, above = world.slabs[0], world.slabs[2]
    world.grip(over(above))

    world.release(over(below, height=20.0))

    assert world.events[-1].kind is EventKind.STACKED
    assert world.slabs[2].bottom_mm == pytest.approx(10.0)
    assert not world.grip(over(below))
    assert world.grip(over(below, height=20.0))


def test_a_slab_pressed_into_another_is_recorded() -> None:
    world = World(DRESDEN, 1)
    below = world.slabs[0]
    world.grip(over(world.slabs[2]))

    world.release(over(below, height=10.0 + 5.0))

    assert [event.kind for event in world.events[1:]] == [EventKind.COLLIDED, EventKind.CRUSHED]


def test_a_carried_slab_that_strikes_another_is_recorded_once_and_passes_clear_above_it() -> None:
    world = World(DRESDEN, 1)
    other = world.slabs[0]
    world.grip(over(world.slabs[2]))

    for height in (40.0, 21.5, 20.5):
        world.moved(over(other, height=height))
    assert [event.kind for event in world.events] == [EventKind.GRIPPED]

    for height in (15.0, 14.0):
        world.moved(over(other, height=height))
    assert [event.kind for event in world.events] == [EventKind.GRIPPED, EventKind.COLLIDED]
    assert world.events[-1].detail == "ran into slab 0"


def test_slabs_laid_side_by_side_are_not_stacked() -> None:
    world = World(DRESDEN, 1)
    lay(world, 2, 2)
    lay(world, 0, 0)

    assert [event.kind for event in world.events] == [EventKind.GRIPPED, EventKind.RELEASED] * 2
    assert [placement.filled for placement in world.placements(SLOTS)] == [True, False, True, False, False]


def lay(world: World, number: int, slot: int, *, dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> None:
    """Carry a slab to a slot by what the truth knows, off by dx, dy, turn in the assembly frame."""
    slab = world.slabs[number]
    goal = shapely.Polygon(SLOTS[slot]).centroid
    start = np.asarray(shapely.Polygon(DRESDEN.outlines[number].outline).centroid.coords)[0]
    assert len(start) == 2
    assert world.grip(over(slab, a=slab.frame.a_deg))
    world.release(world.scene.assembly.frame @ Frame(goal.x + dx, goal.y + dy, 10.0, turn, 0.0, 180.0))


@pytest.mark.parametrize("turn", [0.0, 90.0, 180.0, -90.0])
def test_placement_errors_are_measured_at_the_slots_centroid_modulo_the_slabs_symmetry(turn: float) -> None:
    world = World(DRESDEN, 1)
    lay(world, 2, 2, dx=0.21, dy=-0.34, turn=turn + 0.8)  # 50 x 50: four-fold symmetry

    placement = world.placements(SLOTS)[2]

    assert placement.slab == 2
    assert placement.filled
    assert (placement.dx_mm, placement.dy_mm) == pytest.approx((0.21, -0.34))
    assert placement.dtheta_deg == pytest.approx(0.8)


def test_a_rectangle_turned_by_a_right_angle_does_not_fill_its_slot() -> None:
    world = World(DRESDEN, 1)
    lay(world, 0, 0, turn=90.0)

    placement = world.placements(SLOTS)[0]

    assert not placement.filled
    assert abs(placement.dtheta_deg) == pytest.approx(90.0)


def test_a_slot_without_a_slab_of_its_shape_is_empty() -> None:
    triangle = np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 20.0]])

    (placement,) = World(DRESDEN, 1).placements([triangle])

    assert placement.slab is None
    assert not placement.filled
    assert np.isnan(placement.dx_mm)


def test_a_mirror_image_does_not_suit_a_slot() -> None:
    body = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 10.0], [12.0, 30.0]])
    scene = replace(DRESDEN, slabs=(replace(DRESDEN.slabs[0], outline=tuple(map(tuple, body.tolist()))),))

    suits, mirrored = (World(scene, 0).placements([body * factor])[0].slab for factor in ((1.0, 1.0), (-1.0, 1.0)))

    assert suits == 0
    assert mirrored is None


def test_a_gripper_that_slips_lays_the_slab_off_by_so_much() -> None:
    world = World(DRESDEN, 1, faults=GripperFaults(slip_mm=0.5, twist_deg=1.0))
    lay(world, 2, 2)
    placement = world.placements(SLOTS)[2]

    assert 0.01 < np.hypot(placement.dx_mm, placement.dy_mm) < 3.0
    assert placement.dtheta_deg != 0.0


def test_a_gripper_that_never_seals_moves_nothing() -> None:
    world = World(DRESDEN, 1, faults=GripperFaults(miss_rate=1.0))

    assert not world.grip(over(world.slabs[0]))
    assert world.events[-1].detail == "the cup did not seal"


pose = st.tuples(
    st.floats(160, 430), st.floats(-280, 280), st.sampled_from([10.0, 20.0, 30.0, 80.0]), st.floats(-180, 180)
)
step = st.tuples(st.sampled_from(["grip", "grip", "move", "release"]), st.integers(-1, 4), pose)


@settings(max_examples=40, deadline=None)
@given(st.lists(step, max_size=30))
def test_whatever_the_gripper_does_every_slab_is_in_one_place_and_only_a_held_one_moves(steps: list) -> None:
    world = World(DRESDEN, 2)
    for verb, target, (x, y, z, a) in steps:
        before, held = world.slabs, world.held
        tcp = Frame(x, y, z, a, 0.0, 180.0) if target < 0 else over(world.slabs[target], a=a)
        {"grip": world.grip, "move": world.moved, "release": world.release}[verb](tcp)
        moved = {one.number for one, old in zip(world.slabs, before, strict=True) if one.frame != old.frame}

        assert moved <= {held, world.held} - {None}
        assert [slab.number for slab in world.slabs] == [0, 1, 2, 3, 4]
        assert world.vacuum == (world.held is not None)
        for slab in world.slabs:
            assert slab.thickness_mm == 10.0
            if slab.number != world.held:
                assert slab.bottom_mm >= 0.0
                assert slab.frame.b_deg == slab.frame.c_deg == 0.0
    grips = sum(event.kind is EventKind.GRIPPED for event in world.events)
    assert sum(world.pick_counts) == grips
