"""The cell with the real vision on the simulated world: does a robot that does what it is told lay the pattern?

And do the bundles that the cell keeps give the same poses again?
"""

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.catalogue import Fault
from slabcell.cell.bundle_file import BundleError, read_bundle
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.replay import replay
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.recipe import load_recipe
from slabcell_drivers.camera import CameraInfo, SimulatedCamera
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import AckState, Request, RequestType, ResultCode, RobotStatus
from slabcell_drivers.simulation import World, load_scene, render_world

pytestmark = pytest.mark.integration

CONFIG = Path(__file__).parents[2] / "config"


def true_calibration(world: World) -> Calibration:
    """Return the lens and place of the scene's camera as they are; the table's frame is then the robot's root."""
    camera = world.scene.camera
    rotation = camera.frame.matrix[:3, :3].T
    matrix = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1.0]])
    return Calibration(
        CameraIdentity(camera.width, camera.height),
        Lens(matrix, np.array(camera.distortion)),
        TablePlane(rotation, -rotation @ camera.frame.matrix[:3, 3]),
    )


def settings_of(world: World, **changes: Any) -> CellSettings:
    table = world.scene.table
    motion = RigidTransform2D(table.frame.a_deg, table.frame.x_mm, table.frame.y_mm)
    area = Polygon.from_points(table.pick_area).transformed(motion)
    slow = {"camera_timeout_s": 60.0, "vision_timeout_s": 60.0}  # a picture is rendered, on a machine that is busy
    return CellSettings(Frame(), world.scene.assembly.frame, Frame(z_mm=260.0), area, **{**slow, **changes})


class Robot:
    """Does what the cell says, in the world; nothing else."""

    def __init__(self, cell: Cell, world: World, settings: CellSettings) -> None:
        self.cell, self.world, self.settings = cell, world, settings
        self.session, self.sequence = 0, 0

    async def ask(self, kind: RequestType, result_id: int = 0, state: AckState = AckState.NONE):
        self.sequence += 1
        status = RobotStatus(mode=4, gripper_holds_part=self.world.vacuum)
        session = 0 if kind is RequestType.HELLO else self.session
        answer = await self.cell.handle(
            Request(kind, session, self.sequence, ack_result_id=result_id, ack_state=state, status=status)
        )
        self.session = answer.session
        return answer

    async def lay_all(self) -> int:
        await self.ask(RequestType.HELLO)
        while True:
            answer = await self.ask(RequestType.TRIGGER)
            if answer.left == 0:
                return answer.code
            while answer.left:
                offer = (await self.ask(RequestType.NEXT)).offer
                assert offer is not None
                await self.ask(RequestType.ACK, offer.result_id, AckState.ACCEPTED)
                self.world.grip(self.settings.pick_base @ offer.pick)
                await self.ask(RequestType.ACK, offer.result_id, AckState.GRASPED)
                self.world.moved(self.settings.place_base @ offer.place)
                self.world.release(self.settings.place_base @ offer.place)
                answer = await self.ask(RequestType.ACK, offer.result_id, AckState.PLACED)


async def run_job(name: str, seed: int, folder: Path) -> tuple[Cell, World, int]:
    world = World(load_scene(CONFIG / "scenes" / f"{name}.toml"), seed)
    camera_spec = world.scene.camera
    info = CameraInfo("simulated", "world", "1", camera_spec.width, camera_spec.height, "Mono8")
    camera = SimulatedCamera(info, lambda number: render_world(world, number))
    settings = settings_of(world)
    ledger = await Ledger.open(folder / "ledger.sqlite")
    cell = Cell(
        camera,
        true_calibration(world),
        load_recipe(CONFIG / "recipes" / f"{name}.toml"),
        arm=KR3_R540,
        settings=settings,
        ledger=ledger,
        bundles=BundleWriter(folder / "bundles"),
    )
    await camera.open(5.0)
    await cell.start()
    try:
        code = await Robot(cell, world, settings).lay_all()
    finally:
        await cell.stop()
        await camera.close()
        await ledger.close()
    return cell, world, code


async def test_the_irregular_pattern_is_laid_measured_and_can_be_replayed(tmp_path):
    cell, world, code = await run_job("irregular", 11, tmp_path)
    assert code == ResultCode.JOB_COMPLETE
    truth = world.placements([slot.vertices for slot in cell.recipe.template.slots])
    assert all(item.filled for item in truth)
    measured = {item.slot: item for item in cell.cycles[-1].placements}
    for item in truth:
        seen = measured[item.slot]
        assert seen.found
        if np.isfinite(seen.dx_mm):  # what edges and joints do not determine is said to be not measured
            assert abs(seen.dx_mm - item.dx_mm) < 0.15
            assert abs(seen.dy_mm - item.dy_mm) < 0.15
    paths = sorted((tmp_path / "bundles").iterdir())
    (cycle,) = [path for path in paths if path.stem.endswith("_cycle")]
    (verification,) = [path for path in paths if path.stem.endswith("_verification")]

    bundle = read_bundle(cycle)
    assert replay(bundle).same
    narrow = dataclasses.replace(
        bundle.recipe, matching=bundle.recipe.matching.model_copy(update={"max_residual_mm": 1e-6})
    )
    assert [item.what.split(",")[0] for item in replay(bundle, narrow).differences] == ["was offered"] * 12

    with pytest.raises(BundleError, match="is a verification"):
        replay(read_bundle(verification))
    with zipfile.ZipFile(verification) as archive:
        report = json.loads(archive.read("as-built.json"))
        assert report["schema"] == "slabcell.as-built/1"
        assert len(report["slots"]) == 12

    import typer

    from slabcell.cli.replay import replay_command

    app = typer.Typer()
    app.command()(replay_command)
    ran = CliRunner().invoke(app, [str(cycle), "--json"])
    assert ran.exit_code == 0
    assert json.loads(ran.stdout)["same"] is True
    assert CliRunner().invoke(app, [str(verification)]).exit_code == 1
    both = CliRunner().invoke(app, [str(verification), str(cycle)])
    assert both.exit_code == 0
    assert "is a verification" in both.stdout.replace("\n", " ")


async def test_a_lost_camera_is_named_and_the_job_goes_on_when_it_is_back(tmp_path):
    world = World(load_scene(CONFIG / "scenes" / "dresden.toml"), 3)
    spec = world.scene.camera
    camera = SimulatedCamera(
        CameraInfo("simulated", "world", "1", spec.width, spec.height, "Mono8"), lambda n: render_world(world, n)
    )
    settings = settings_of(world)
    ledger = await Ledger.open(tmp_path / "ledger.sqlite")
    recipe = load_recipe(CONFIG / "recipes" / "dresden.toml")
    cell = Cell(camera, true_calibration(world), recipe, arm=KR3_R540, settings=settings, ledger=ledger)
    await cell.start()
    robot = Robot(cell, world, settings)
    await robot.ask(RequestType.HELLO)
    assert (await robot.ask(RequestType.TRIGGER)).code == Fault.CAMERA_LOST  # it was never opened
    await camera.open(5.0)
    assert (await robot.ask(RequestType.TRIGGER)).left == 5
    assert cell.alarms.standing == ()
    await cell.stop()
    await camera.close()
    await ledger.close()
