"""How does one cell live as a process?  Configuration to devices to cell; signals, watchdog and an orderly end.

Nothing here moves the robot: the robot asks, the cell answers.  A camera that is not there is looked for in the
background, and the robot is told so until it comes.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import AsyncGenerator, Callable
from pathlib import Path

import structlog

from slabcell.calibration import Calibration, CameraIdentity, load_calibration
from slabcell.catalogue import Fault
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.settings import CellSettings
from slabcell.errors import CalibrationError, ConfigurationError, UnavailableError
from slabcell.geometry import Polygon
from slabcell.recipe import load_recipe
from slabcell.service.config import CellConfig, load_config
from slabcell.service.devices import InstanceLock, make_camera, state_directory
from slabcell.service.notify import notify, watchdog_interval_s
from slabcell_drivers.camera import Camera, CameraError
from slabcell_drivers.robot.arm import arm_by_name
from slabcell_drivers.robot.eki.client import EkiClient
from slabcell_drivers.robot.eki.link import EkiServer

__all__ = ["run_daemon"]

CAMERA_OPEN_TIMEOUT_S = 10.0
CAMERA_RETRY_S = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
STOP_TIMEOUT_S = 5.0
ALIVE_TIMEOUT_S = 2.0

_log = structlog.get_logger(__name__)


async def run_daemon(path: Path, *, ready: Callable[[tuple[str, int]], None] | None = None) -> None:
    """Run the cell of a configuration file until SIGTERM or SIGINT; ``ready`` is told where both meet.

    Raises ConfigurationError, CalibrationError, RecipeError, TemporaryError (a second instance) or UnavailableError
    (the address is taken) before anything runs.
    """
    config = load_config(path)
    if config.calibration is None:
        msg = f"{path}: calibration is missing: make one with `slabcell calibrate camera` and `plane`, and name it here"
        raise ConfigurationError(msg)
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    try:
        folder = state_directory(config.state_directory)
        with InstanceLock(folder):
            async with _cell(config, folder) as (cell, ledger), _link(config, cell) as address:
                _log.info("ready", cell=config.name, recipe=cell.recipe.name, robot=f"{address[0]}:{address[1]}")
                if ready is not None:
                    ready(address)
                notify(f"READY=1\nSTATUS=recipe {cell.recipe.name}, waiting for the robot")
                async with _watched(ledger):
                    await stopping.wait()
                notify("STOPPING=1")
                _log.info("stopping")
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)


@contextlib.asynccontextmanager
async def _cell(config: CellConfig, folder: Path) -> AsyncGenerator[tuple[Cell, Ledger]]:
    recipe = load_recipe(config.recipe)
    calibration = load_calibration(config.calibration or Path())
    settings = CellSettings(
        pick_base=config.robot.pick_base.to_frame(),
        place_base=config.robot.place_base.to_frame(),
        tool=config.robot.tool.to_frame(),
        pick_area=Polygon.from_points(config.table.pick_area),
        camera_timeout_s=config.camera.timeout_s,
    )
    camera = make_camera(config.camera)
    ledger = await Ledger.open(folder / "ledger.sqlite")
    try:
        cell = Cell(
            camera,
            calibration,
            recipe,
            arm=arm_by_name(config.robot.model),
            settings=settings,
            ledger=ledger,
            bundles=BundleWriter(folder / "bundles"),
        )
        await cell.start()
        opening = asyncio.create_task(_open(camera, calibration, cell), name="slabcell-camera-open")
        try:
            yield cell, ledger
        finally:
            opening.cancel()
            await asyncio.gather(opening, return_exceptions=True)
            await cell.stop()
            await camera.close()
    finally:
        await ledger.close()


async def _open(camera: Camera, calibration: Calibration, cell: Cell) -> None:
    """Open the camera, however long it takes to come; once open, its driver brings it back by itself.

    A camera that is not the calibrated one is closed again, and the cell halts: no pose may come from it.
    """
    attempt = 0
    while True:
        try:
            info = await camera.open(CAMERA_OPEN_TIMEOUT_S)
        except CameraError as error:
            pause_s = CAMERA_RETRY_S[min(attempt, len(CAMERA_RETRY_S) - 1)]
            _log.warning("camera not open", error=str(error), next_try_s=pause_s)
            attempt += 1
            await asyncio.sleep(pause_s)
        else:
            break
    _log.info("camera open", model=info.model, serial=info.serial, width=info.width, height=info.height)
    try:
        calibration.require_camera(CameraIdentity(info.width, info.height, info.serial), f"camera {info.serial}")
    except CalibrationError as error:
        _log.exception("camera refused")
        await camera.close()
        cell.alarms.come(Fault.CALIBRATION_MISMATCH, str(error))
        await cell.halt(str(error))


@contextlib.asynccontextmanager
async def _link(config: CellConfig, cell: Cell) -> AsyncGenerator[tuple[str, int]]:
    """Serve the robot; gives the address at which both meet."""
    krl, eki = config.robot.krl, config.robot.eki
    link = EkiServer(eki.host, eki.port) if krl.robot_connects else EkiClient(krl.robot_ip, krl.robot_port)
    try:
        await link.start(cell.handle)
    except OSError as error:
        msg = (
            f"[robot.eki] {eki.host}:{eki.port} cannot be listened on: {error.strerror};"
            " is the address this PC's own, and the port free?"
        )
        raise UnavailableError(msg) from error
    try:
        yield link.address if isinstance(link, EkiServer) else (krl.robot_ip, krl.robot_port)
    finally:
        async with asyncio.timeout(STOP_TIMEOUT_S):
            await link.stop()


@contextlib.asynccontextmanager
async def _watched(ledger: Ledger) -> AsyncGenerator[None]:
    """Feed the supervisor's watchdog for as long as the loop turns and the ledger answers."""
    interval_s = watchdog_interval_s()
    if interval_s is None:
        yield
        return
    feeding = asyncio.create_task(_feed(ledger, interval_s), name="slabcell-watchdog")
    try:
        yield
    finally:
        feeding.cancel()
        await asyncio.gather(feeding, return_exceptions=True)


async def _feed(ledger: Ledger, interval_s: float) -> None:
    while True:
        try:
            async with asyncio.timeout(ALIVE_TIMEOUT_S):
                await ledger.run(lambda file: file.counters())
        except TimeoutError:
            _log.exception("the ledger does not answer; the watchdog is not fed")
        else:
            notify("WATCHDOG=1")
        await asyncio.sleep(interval_s)
