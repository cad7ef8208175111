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
from slabcell.vision.layers import LayeredLocator
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


THICK_MM = 9.0


def thick_and_thin(world: World, thick: set[int]):
    return [
        dataclasses.replace(slab, thickness_mm=slab.thickness_mm + THICK_MM) if number in thick else slab
        for number, slab in enumerate(world.slabs)
    ]


def test_slabs_of_two_thicknesses_are_each_located_at_their_own_height():
    world = World(load_scene(CONFIG / "scenes" / "irregular.toml"), 5)
    thick = {1, 4}
    slabs = thick_and_thin(world, thick)
    slots = tuple(Polygon.from_points(slab.body) for slab in slabs)
    heights = {number: slabs[number].thickness_mm for number in thick}
    flat = Recipe.from_template(Template("two", slots, ""), slabs[0].thickness_mm)
    recipe = dataclasses.replace(flat, other_thickness_mm=heights)
    picture = render_slabs(world.scene.camera, world.scene.optics, slabs, seed=5)
    calibration = true_calibration(world)

    def off_mm(part) -> float:
        frame, middle = slabs[part.slot].frame, slots[part.slot].centroid
        truth = RigidTransform2D(frame.a_deg, frame.x_mm, frame.y_mm)
        return float(np.hypot(*(part.table_to_assembly.inverse().apply(middle) - truth.apply(middle))))

    result = LayeredLocator(calibration, recipe).locate(picture)
    assert [part.slot for part in result.parts] == list(range(len(slots)))
    assert result.rejected == ()
    assert max(off_mm(part) for part in result.parts) < 0.06
    # With one thickness for all, the thick ones are off by their parallax, or not found at all.
    naive = {part.slot: off_mm(part) for part in locate(picture, calibration, flat).parts}
    assert all(naive.get(slot, 1.0) > 0.3 for slot in thick)


def test_slots_of_one_outline_and_two_thicknesses_are_refused_because_nobody_can_tell():
    world = World(load_scene(CONFIG / "scenes" / "irregular.toml"), 5)
    outline = Polygon.from_points(world.slabs[0].body)
    slots = (
        outline,
        Polygon.from_points(outline.vertices + np.array([500.0, 0.0])),
        Polygon.from_points(world.slabs[2].body),
    )
    flat = Recipe.from_template(Template("alike", slots, ""), world.slabs[0].thickness_mm)
    recipe = dataclasses.replace(flat, other_thickness_mm={1: world.slabs[0].thickness_mm + 0.8})
    picture = render_slabs(world.scene.camera, world.scene.optics, [world.slabs[0], world.slabs[2]], seed=5)
    result = LayeredLocator(true_calibration(world), recipe).locate(picture)
    assert [part.slot for part in result.parts] == [2]
    assert [blob.reason for blob in result.rejected] == ["unsure"]
    assert "not told apart from above" in result.rejected[0].detail


def test_laid_slabs_of_two_thicknesses_are_measured_at_their_own_height():
    world = World(load_scene(CONFIG / "scenes" / "irregular.toml"), 6)
    thick = {0}
    slabs = thick_and_thin(world, thick)
    frame = world.scene.assembly.frame
    in_table = RigidTransform2D(frame.a_deg, frame.x_mm, frame.y_mm)
    # Apart from each other, so that every edge is free.
    slots = tuple(
        Polygon.from_points(slab.body + np.array([60.0 * number, 0.0])) for number, slab in enumerate(slabs[:2])
    )
    laid = [
        dataclasses.replace(
            slab,
            body=slot.vertices,
            nominal=slot.vertices,
            frame=Frame(in_table.x_mm, in_table.y_mm, 0.0, in_table.rotation_deg, 0.0, 0.0),
        )
        for slab, slot in zip(slabs, slots, strict=False)
    ]
    flat = Recipe.from_template(Template("two", slots, ""), slabs[1].thickness_mm)
    recipe = dataclasses.replace(flat, other_thickness_mm={0: slabs[0].thickness_mm})
    picture = render_slabs(world.scene.camera, world.scene.optics, laid, seed=6)
    eyes = LayeredLocator(true_calibration(world), recipe)
    for item in eyes.measure(picture, assembly_in_table=in_table, slots=(0, 1)):
        assert (item.found, item.measured) == (True, True)
        assert (item.dx_mm, item.dy_mm, item.da_deg) == pytest.approx((0, 0, 0), abs=0.08)
