"""May a recipe become the active one only if it finds again what a person has graded?"""

import asyncio
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.settings import CellSettings
from slabcell.cli.recipe import recipe_app
from slabcell.errors import RecipeError
from slabcell.geometry import Polygon
from slabcell.recipe import load_recipe
from slabcell.service import recipes
from slabcell.service.active_recipe import RecipeShelf
from slabcell_drivers.camera.protocol import CameraInfo
from slabcell_drivers.camera.simulated import SimulatedCamera
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import Request, RequestType
from slabcell_drivers.simulation import World, load_scene, render_world

pytestmark = pytest.mark.unit

CONFIG = Path(__file__).parents[3] / "config"


async def one_cycle(folder: Path) -> Path:
    """Let a cell look once at the simulated table; return the bundle of it."""
    world = World(load_scene(CONFIG / "scenes" / "dresden.toml"), 5)
    spec = world.scene.camera
    view = (world.scene.table.frame.inverse() @ spec.frame).matrix
    rotation = view[:3, :3].T
    matrix = np.array([[spec.fx_px, 0.0, spec.cx_px], [0.0, spec.fy_px, spec.cy_px], [0.0, 0.0, 1.0]])
    calibration = Calibration(
        CameraIdentity(spec.width, spec.height, spec.serial),
        Lens(matrix, np.array(spec.distortion)),
        TablePlane(rotation, -rotation @ view[:3, 3]),
    )
    info = CameraInfo("simulated", "world", spec.serial, spec.width, spec.height, "Mono8")
    camera = SimulatedCamera(info, lambda number: render_world(world, number))
    scene = world.scene
    settings = CellSettings(
        *(scene.table.frame, scene.assembly.frame, Frame(z_mm=260.0), Polygon.from_points(scene.table.pick_area)),
        check_assembly_is_empty=False,
        camera_timeout_s=60.0,  # the picture is rendered, on whatever machine this is
        vision_timeout_s=60.0,
    )
    ledger = await Ledger.open(folder / "ledger.sqlite")
    recipe = load_recipe(CONFIG / "recipes" / "dresden.toml")
    bundles = BundleWriter(folder / "bundles")
    cell = Cell(camera, calibration, recipe, arm=KR3_R540, settings=settings, ledger=ledger, bundles=bundles)
    await camera.open(5.0)
    await cell.start()
    session = (await cell.handle(Request(RequestType.HELLO, 0, 1))).session
    assert (await cell.handle(Request(RequestType.TRIGGER, session, 2))).left == 5
    await cell.stop()
    await camera.close()
    await ledger.close()
    (bundle,) = (folder / "bundles").iterdir()
    return bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return asyncio.run(one_cycle(tmp_path_factory.mktemp("cycle")))


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    for name in ("recipes", "templates"):
        shutil.copytree(CONFIG / name, tmp_path / name)
    shutil.copy(CONFIG / "cell.toml", tmp_path / "cell.toml")
    return tmp_path / "recipes" / "dresden.toml"


def run(*words: object, code: int = 0) -> str:
    ran = CliRunner().invoke(recipe_app, [str(word) for word in words])
    assert ran.exit_code == code, (ran.output, ran.exception)
    return ran.stdout


def spoil(recipe: Path) -> None:
    recipe.write_text(recipe.read_text() + "\n[matching]\nmax_residual_mm = 0.000001\n")


def test_a_recipe_that_finds_the_graded_slabs_again_becomes_active(recipe, bundle, tmp_path, monkeypatch):
    monkeypatch.setenv("SLABCELL_SOCKET", str(tmp_path / "nobody"))
    run("grade", recipe, bundle)
    document = json.loads(run("verify", recipe, "--json"))
    assert document["passed"]
    assert [item["problems"] for item in document["pictures"]] == [[]]
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    other = recipe.with_name("irregular.toml")
    assert RecipeShelf(other, tmp_path).active == other
    assert "from the next start on" in run("activate", recipe, "--config", tmp_path / "cell.toml")
    assert RecipeShelf(other, tmp_path).active == recipe


def test_a_recipe_that_does_not_find_them_is_refused_and_the_active_one_stays(recipe, bundle, tmp_path):
    run("grade", recipe, bundle)
    spoil(recipe)
    shown = run("verify", recipe, code=1)
    assert shown.count("was offered, is not now") == 5
    with pytest.raises(RecipeError, match="does not pass its graded set") as caught:
        recipes.activate(recipe, tmp_path / "cell.toml", recipes.verify(recipe))
    assert caught.value.exit_code == 78
    assert not (tmp_path / "active-recipe.json").exists()


def test_a_recipe_that_was_changed_after_it_was_verified_is_refused(recipe, bundle, tmp_path):
    recipes.add_graded(recipe, [bundle])
    done = recipes.verify(recipe)
    recipe.write_text(recipe.read_text() + "# touched\n")
    with pytest.raises(RecipeError, match="has changed since it was verified"):
        recipes.activate(recipe, tmp_path / "cell.toml", done)


def test_the_version_of_a_recipe_follows_its_file_its_template_and_its_set(recipe, bundle):
    before = recipes.recipe_sha256(recipe)
    template = recipe.parents[1] / "templates" / "dresden.csv"
    written = template.read_text()
    head, *lines = written.splitlines()
    template.write_text("\n".join([head, *reversed(lines)]) + "\n")
    assert recipes.recipe_sha256(recipe) != before
    template.write_text(written)
    assert recipes.recipe_sha256(recipe) == before
    recipes.add_graded(recipe, [bundle])
    with_set = recipes.recipe_sha256(recipe)
    spoil(recipe)
    assert len({before, with_set, recipes.recipe_sha256(recipe)}) == 3


def test_a_bundle_of_another_template_is_not_taken_into_the_set(recipe, bundle):
    with pytest.raises(RecipeError, match="the recipe's is irregular"):
        recipes.add_graded(recipe.with_name("irregular.toml"), [bundle])


def test_a_recipe_without_a_set_passes_and_says_so(recipe):
    assert "no graded set" in run("verify", recipe)


def test_a_recipe_that_lies_elsewhere_is_refused_with_the_folder_it_belongs_to(recipe, tmp_path):
    elsewhere = shutil.copytree(recipe.parent, tmp_path / "elsewhere" / "recipes") / recipe.name
    shutil.copytree(recipe.parents[1] / "templates", tmp_path / "elsewhere" / "templates")
    with pytest.raises(RecipeError, match="copy it there"):
        recipes.activate(elsewhere, tmp_path / "cell.toml", recipes.verify(elsewhere))
