import itertools
from pathlib import Path

import numpy as np
import pytest
import shapely

from slabcell.recipe import load_recipe
from slabcell_drivers.simulation import Scene, SceneError, World, load_scene
from slabcell_drivers.simulation.placement import congruences
from slabcell_drivers.simulation.projection import Projector

pytestmark = pytest.mark.unit

CONFIG = Path(__file__).parents[3] / "config"
SIZES = {"dresden": (163.0, 88.0), "irregular": (200.0, 150.0), "stones": (200.0, 150.0)}


def scene(name: str) -> Scene:
    return load_scene(CONFIG / "scenes" / f"{name}.toml")


def template(name: str) -> list[np.ndarray]:
    recipe = load_recipe(CONFIG / "recipes" / f"{name}.toml")
    return [slot.vertices for slot in recipe.template.slots]


@pytest.mark.parametrize("name", SIZES)
def test_every_slab_of_a_scene_is_a_slot_of_its_template_and_each_slot_has_one(name: str) -> None:
    slabs, slots = [np.array(slab.outline) for slab in scene(name).outlines], template(name)

    suits = np.array([[bool(congruences(slab, slot, 1e-6)) for slot in slots] for slab in slabs])

    assert np.array_equal(suits, np.eye(len(slots), dtype=bool))


@pytest.mark.parametrize("name", SIZES)
def test_a_template_tiles_its_rectangle_without_gap_or_overlap(name: str) -> None:
    shapes = [shapely.Polygon(slot) for slot in template(name)]
    rectangle = shapely.box(0, 0, *SIZES[name])

    assert all(shape.is_valid for shape in shapes)
    assert max(a.intersection(b).area for a, b in itertools.combinations(shapes, 2)) < 1e-9
    assert shapely.union_all(shapes).symmetric_difference(rectangle).area < 1e-9


def test_the_irregular_slabs_are_twelve_at_least_four_concave_and_all_take_the_cup() -> None:
    shapes = [shapely.Polygon(slot) for slot in template("irregular")]

    assert len(shapes) == 12
    assert sum(shape.area < 0.95 * shape.convex_hull.area for shape in shapes) >= 4
    assert min(shapely.maximum_inscribed_circle(shape, tolerance=0.1).length for shape in shapes) > 10.0
    assert all(shape.buffer(-5.0).geom_type == "Polygon" for shape in shapes)  # no neck thinner than cup and margin


@pytest.mark.parametrize("name", SIZES)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_slabs_lie_apart_inside_the_pick_area_and_wholly_in_view(name: str, seed: int) -> None:
    world = World(scene(name), seed)
    shapes = [slab.shape for slab in world.slabs]
    projector = Projector(world.scene.camera)
    corners = np.concatenate(
        [np.column_stack([slab.outline, np.full(len(slab.outline), 10.0)]) for slab in world.slabs]
    )
    pixels = projector.pixels(corners)
    area = np.array(world.scene.table.pick_area)
    frame = world.scene.table.frame.matrix

    assert min(a.distance(b) for a, b in itertools.combinations(shapes, 2)) >= 4.0
    assert shapely.Polygon(area @ frame[:2, :2].T + frame[:2, 3]).buffer(1e-9).contains(shapely.union_all(shapes))
    assert np.all(pixels > 10)
    assert np.all(pixels < (world.scene.camera.width - 10, world.scene.camera.height - 10))


@pytest.mark.parametrize("name", SIZES)
def test_the_assembly_is_wholly_in_view(name: str) -> None:
    one = scene(name)
    points = np.concatenate(template(name))
    frame = one.assembly.frame.matrix
    pixels = Projector(one.camera).pixels(
        np.column_stack([points, np.full(len(points), 10.0), np.ones(len(points))])[:, :4] @ frame[:3].T
    )

    assert np.all(pixels > 10)
    assert np.all(pixels < (one.camera.width - 10, one.camera.height - 10))


def test_every_shipped_scene_has_a_recipe_of_its_name_and_its_thickness() -> None:
    names = {file.stem for file in (CONFIG / "scenes").glob("*.toml")}

    assert names == set(SIZES)
    for name in names:
        thickness = load_recipe(CONFIG / "recipes" / f"{name}.toml").thickness_mm
        assert {slab.thickness_mm for slab in scene(name).outlines} == {thickness}


def test_marks_lie_on_the_board_in_view_and_apart_from_slabs_and_assembly() -> None:
    one = scene("stones")
    frame = one.table.frame.matrix
    marks = np.array(one.table.marks) @ frame[:2, :2].T + frame[:2, 3]
    pixels = Projector(one.camera).pixels(np.column_stack([marks, np.zeros(len(marks))]))
    radius = one.table.mark_radius_mm
    place = one.assembly.frame.matrix
    laid = shapely.MultiPoint(np.concatenate(template("stones")) @ place[:2, :2].T + place[:2, 3]).convex_hull

    for (x, y), mark in zip(one.table.marks, marks, strict=True):
        assert shapely.Polygon(one.table.board).exterior.distance(shapely.Point(x, y)) > 3 * radius
        assert shapely.Polygon(one.table.pick_area).distance(shapely.Point(x, y)) > 5.0
        assert laid.distance(shapely.Point(mark)) > 20.0
    assert np.all(pixels > 20)
    assert np.all(pixels < (one.camera.width - 20, one.camera.height - 20))
    assert np.pi * radius**2 < 25.0  # smaller than any slab that a recipe accepts


def test_the_same_seed_strews_the_same_and_another_seed_does_not() -> None:
    one = scene("dresden")

    assert [slab.frame for slab in World(one, 3).slabs] == [slab.frame for slab in World(one, 3).slabs]
    assert [slab.frame for slab in World(one, 3).slabs] != [slab.frame for slab in World(one, 4).slabs]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("blur_sigma_px", "blur_sigma_pixel", r"optics: unknown key 'blur_sigma_pixel': did you mean 'blur_sigma_px'"),
        ("width = 1920", "width = 1.5", r"camera.width = 1.5: must be int"),
        ("fx_px = 3333.0", "fx_px = nan", r"camera.fx_px = nan: must be a finite number"),
        ("fx_px = 3333.0\n", "", r"camera: key 'fx_px' is missing"),
        ("blur_sigma_px = 0.8", "blur_sigma_px = 80.0", r"optics: blur_sigma_px = 80.0 is outside 0 to 20"),
        ("[table]", "[table", r"is not TOML"),
        ("[88, 0], [88, 50]", "[88, 50], [88, 0]", r"slab\[0\]: outline crosses itself"),
        ("thickness_mm = 10.0\n", 'thickness_mm = "10"\n', r"slab\[0\].thickness_mm = '10': must be a finite number"),
        ("[[slab]]", "[[slabs]]", r"has no slabs"),
    ],
)
def test_a_wrong_scene_file_is_refused_by_file_key_and_remedy(tmp_path: Path, old: str, new: str, says: str) -> None:
    text = (CONFIG / "scenes" / "dresden.toml").read_text()
    assert old in text
    file = tmp_path / "scene.toml"
    file.write_text(text.replace(old, new))

    with pytest.raises(SceneError, match=rf"scene\.toml.*{says}"):
        load_scene(file)


def test_a_scene_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"none\.toml: cannot be read"):
        load_scene(tmp_path / "none.toml")
