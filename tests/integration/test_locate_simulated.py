"""The vision on the simulated cell: thick slabs with visible walls, uneven light, shadows, texture, noise."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Template, load_template
from slabcell.vision import locate
from slabcell.vision.placement import measure_placement
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation import World, load_scene
from slabcell_drivers.simulation.rendering import render_slabs, render_world

pytestmark = pytest.mark.integration

CONFIG = Path(__file__).parents[2] / "config"


def true_calibration(world: World) -> Calibration:
    """Return the lens and place of the scene's camera, as they are."""
    camera = world.scene.camera
    a, b, c = np.deg2rad([camera.frame.a_deg, camera.frame.b_deg, camera.frame.c_deg])
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    rotation = (about_z @ about_y @ about_x).T
    place = np.array([camera.frame.x_mm, camera.frame.y_mm, camera.frame.z_mm])
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    return Calibration(
        CameraIdentity(camera.width, camera.height),
        Lens(matrix, np.array(camera.distortion)),
        TablePlane(rotation, -rotation @ place),
    )


@pytest.mark.parametrize("name", ["dresden", "irregular"])
def test_all_slabs_of_a_scene_are_located_to_a_fifth_of_a_pixel(name: str):
    world = World(load_scene(CONFIG / "scenes" / f"{name}.toml"), 5)
    slots = tuple(Polygon.from_points(slab.body) for slab in world.slabs)
    recipe = Recipe.from_template(Template(name, slots, ""), world.slabs[0].thickness_mm)
    result = locate(render_world(world), true_calibration(world), recipe)
    assert [part.slot for part in result.parts] == list(range(len(slots)))
    for part in result.parts:
        frame = world.slabs[part.slot].frame
        truth = RigidTransform2D(frame.a_deg, frame.x_mm, frame.y_mm)
        middle = slots[part.slot].centroid
        found = part.table_to_assembly.inverse()
        assert np.hypot(*(found.apply(middle) - truth.apply(middle))) < 0.06  # mm; a pixel is 0.31 mm
        step = 360 / part.symmetry_order
        turn = (found.rotation_deg - truth.rotation_deg) / step
        assert abs(turn - round(turn)) * step < 0.05


def test_laid_slabs_are_measured_in_their_slots():
    world = World(load_scene(CONFIG / "scenes" / "irregular.toml"), 6)
    template = load_template(CONFIG / "templates" / "irregular.csv")
    frame = world.scene.assembly.frame
    in_table = RigidTransform2D(frame.a_deg, frame.x_mm, frame.y_mm)
    random = np.random.default_rng(6)
    moves = random.normal(0, 0.05, (len(template.slots), 3))
    slabs = []
    for slot, da in enumerate(moves[:, 2]):
        middle = template.slots[slot].centroid
        turn = RigidTransform2D(float(da), 0.0, 0.0)
        shift = middle + moves[slot, :2] - turn.apply(middle)
        lies = in_table @ RigidTransform2D(float(da), float(shift[0]), float(shift[1]))
        slabs.append(
            dataclasses.replace(
                world.slabs[slot],
                body=template.slots[slot].vertices,
                nominal=template.slots[slot].vertices,
                frame=Frame(lies.x_mm, lies.y_mm, 0.0, lies.rotation_deg, 0.0, 0.0),
            )
        )
    picture = render_slabs(world.scene.camera, world.scene.optics, slabs[:-1], seed=6)
    recipe = Recipe.from_template(template, slabs[0].thickness_mm)
    result = measure_placement(
        picture, true_calibration(world), recipe, assembly_in_table=in_table, slots=range(len(slabs))
    )
    assert [item.found for item in result] == [True] * (len(slabs) - 1) + [False]
    for item in result[:-1]:
        assert item.measured
        assert (item.dx_mm, item.dy_mm, item.da_deg) == pytest.approx(tuple(moves[item.slot]), abs=0.05)
