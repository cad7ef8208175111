"""What else can be in the picture: obstructions, marks, the board's rim, stone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slabcell_drivers.robot import Frame
from slabcell_drivers.simulation import World, arm_in_view, hand_in_view, load_scene, render_world
from slabcell_drivers.simulation.projection import Projector
from slabcell_drivers.simulation.rendering import irradiance
from slabcell_drivers.simulation.surfaces import Surface

pytestmark = pytest.mark.unit

SCENE = load_scene(Path(__file__).parents[3] / "config" / "scenes" / "dresden.toml")
SMALL = replace(
    SCENE, camera=replace(SCENE.camera, width=480, height=300, fx_px=833.0, fy_px=833.0, cx_px=240.0, cy_px=149.0)
)


def at(world: World, x: float, y: float, z: float) -> tuple[int, int]:
    u, v = Projector(world.scene.camera).pixels(np.array([[x, y, z]]))[0]
    return round(v), round(u)


def test_a_hand_covers_what_is_below_it_until_it_is_taken_away() -> None:
    world = World(SMALL, 1)
    slab = world.slabs[0]
    where = at(world, slab.frame.x_mm, slab.frame.y_mm, 100.0)
    free = render_world(world)

    world.obstruct(hand_in_view(slab.frame.x_mm, slab.frame.y_mm, 90.0, tone=0.5))
    covered = render_world(world)
    world.obstruct()

    assert free[where] > 140
    assert covered[where] < 0.7 * free[where]
    assert np.array_equal(render_world(world), free)
    assert world.slabs[0] is slab


def test_an_arm_in_view_changes_the_picture_over_the_assembly() -> None:
    world = World(SMALL, 1)
    free = render_world(world).astype(int)

    world.obstruct(*arm_in_view((0.0, 60.0), (280.0, 120.0)))

    assert np.mean(np.abs(render_world(world) - free) > 60) > 0.05


def test_marks_are_where_the_table_frame_says_and_slabs_hide_them() -> None:
    marks = ((20.0, 20.0), (200.0, 500.0))
    scene = replace(SMALL, table=replace(SMALL.table, marks=marks, mark_radius_mm=4.0))
    world = World(scene, 1)
    optics = replace(scene.optics, table_texture=0.0, contact_shadow=0.0, cast_shadow=0.0, unevenness=0.0)

    empty = irradiance(scene.camera, optics, [], table=scene.table) - optics.table_dn
    hidden = irradiance(
        scene.camera, optics, [replace(world.slabs[0], frame=scene.table.frame @ Frame(20.0, 20.0))], table=scene.table
    )

    v, u = np.mgrid[0 : scene.camera.height, 0 : scene.camera.width]
    for x, y in marks:
        point = scene.table.frame @ Frame(x, y)
        truth = Projector(scene.camera).pixels(np.array([[point.x_mm, point.y_mm, 0.0]]))[0]
        near = np.hypot(u - truth[0], v - truth[1]) < 10
        weight = empty * near
        found = np.array([np.sum(weight * u), np.sum(weight * v)]) / weight.sum()
        assert np.allclose(found, truth, atol=0.02)
    first = at(world, *(scene.table.frame @ Frame(20.0, 20.0)).as_tuple()[:2], 0.0)
    assert hidden[first] == pytest.approx(optics.slab_dn * world.slabs[0].tone, rel=0.1)


def test_beyond_the_boards_rim_the_floor_is_seen() -> None:
    board = ((-20.0, -20.0), (270.0, -20.0), (270.0, 520.0), (-20.0, 520.0))
    scene = replace(SMALL, table=replace(SMALL.table, board=board))
    world = World(scene, 1)

    picture = render_world(world)

    inside, outside = ((scene.table.frame @ Frame(x, 250.0)).as_tuple()[:2] for x in (262.0, 284.0))
    assert picture[at(world, *inside, 0.0)] < 45
    assert picture[at(world, *outside, 0.0)] > 60


@pytest.mark.parametrize("surface", list(Surface))
def test_every_stone_keeps_its_mean_brightness_and_varies_as_much_as_asked(surface: Surface) -> None:
    still = replace(SMALL.optics, slab_spread=0.0, unevenness=0.0, blur_sigma_px=0.0)
    optics = replace(still, surface=surface, slab_texture=0.1)
    world = World(replace(SMALL, optics=optics), 1)

    picture = irradiance(SMALL.camera, optics, [replace(slab, tone=1.0) for slab in world.slabs])

    on_slab = picture[picture > 110]
    assert on_slab.mean() == pytest.approx(optics.slab_dn, rel=0.06)
    assert 0.02 < on_slab.std() / on_slab.mean() < 0.15
