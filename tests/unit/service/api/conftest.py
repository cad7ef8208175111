"""A cell behind its control API, in this process: a real socket, a real ledger, a camera that renders grey pictures."""

from collections.abc import AsyncIterator
from pathlib import Path

import numpy as np
import pytest

from slabcell.calibration import save_calibration
from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon
from slabcell.recipe import Recipe
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.app import make_app
from slabcell.service.api.context import ApiContext
from slabcell.service.api.ring import EventRing
from slabcell.service.api.server import listen, serve
from slabcell.service.api.stream import StreamSeats
from slabcell.service.bench.workbench import Workbench
from slabcell.service.builder import CellParts, open_cell
from slabcell.service.bundles import BundleShelf
from slabcell.service.calibrations import CalibrationShelf
from slabcell.service.event_feed import EventFeed
from slabcell.service.frames import FrameStore
from slabcell.service.history import History
from slabcell.service.ledger_view import LedgerView
from slabcell.service.links import Links
from slabcell.service.picture_sets import PictureSets
from slabcell.service.pictures import Pictures
from slabcell.service.robot_watch import RobotWatch
from slabcell.service.studio import Studio
from slabcell.template import Template
from slabcell_drivers.camera.protocol import CameraInfo
from slabcell_drivers.camera.simulated import SimulatedCamera
from slabcell_drivers.robot import Frame
from slabcell_drivers.robot.arm import KR3_R540

WIDTH, HEIGHT = 640, 480


def render(number: int):
    picture = np.full((HEIGHT, WIDTH), 40, np.uint8)
    picture[100:200, 100:200] = 220
    return picture


def make_parts() -> CellParts:
    square = Polygon.from_points([(0.0, 0.0), (30.0, 0.0), (30.0, 30.0), (0.0, 30.0)])
    recipe = Recipe.from_template(Template("squares", (square,), "a" * 64), 10.0)
    lens = Lens(np.array([[400.0, 0, 320], [0, 400.0, 240], [0, 0, 1]]), np.zeros(5))
    plane = TablePlane(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 500.0]))
    area = Polygon.from_points([(-300, -300), (300, -300), (300, 300), (-300, 300)])
    settings = CellSettings(
        Frame(200.0, -200.0), Frame(220.0, 100.0), Frame(z_mm=260.0), area, check_assembly_is_empty=False
    )
    return CellParts(Calibration(CameraIdentity(WIDTH, HEIGHT), lens, plane), recipe, KR3_R540, settings)


@pytest.fixture
async def api(tmp_path: Path) -> AsyncIterator[ApiContext]:
    camera = SimulatedCamera(CameraInfo("none", "simulated", "1", WIDTH, HEIGHT, "Mono8"), render)
    await camera.open(1.0)
    history = await History.open(tmp_path / "history.sqlite")
    ring, links, frames = EventRing("run1"), Links(), FrameStore("run1")
    feed = EventFeed(ring, history, links, frames)
    links.changed = feed.link_changed
    async with open_cell(make_parts(), camera, tmp_path) as (cell, _):
        unsubscribe = cell.subscribe(feed.see)
        view = LedgerView(tmp_path / "ledger.sqlite")
        bundles = BundleShelf(tmp_path / "bundles")
        shelf = RecipeShelf(tmp_path / "recipes" / "squares.toml", tmp_path)
        pictures = Pictures(frames, bundles, history, shelf, PictureSets(tmp_path / "pictures"))
        studio = Studio(Workbench(), pictures)
        recipes = tmp_path / "recipes"
        recipes.mkdir()
        (recipes / "squares.csv").write_text("0,0,30,0,30,30,0,30\n")
        (recipes / "squares.toml").write_text('[template]\nfile = "squares.csv"\nthickness_mm = 10.0\n')
        calibrations = CalibrationShelf(tmp_path / "calibration.json", tmp_path)
        save_calibration(tmp_path / "calibration.json", cell.calibration)
        context = ApiContext(
            name="test",
            started_s=0.0,
            cell=cell,
            links=links,
            robot=RobotWatch(cell, links),
            history=history,
            ledger=view,
            ring=ring,
            seats=StreamSeats(2),
            frames=frames,
            bundles=bundles,
            studio=studio,
            recipes=shelf,
            calibrations=calibrations,
        )
        path = tmp_path / "api.sock"
        async with serve(make_app(context), listen(path, mode=0o660, group=None), path):
            unwatch = cell.subscribe(studio.bench.see)
            yield context
            ring.close()
            unwatch()
        await studio.close()
        await view.close()
        unsubscribe()
    await frames.close()
    await history.close()
    await camera.close()
