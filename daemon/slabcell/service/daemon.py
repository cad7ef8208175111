"""How does one cell live as a process?  Configuration to devices to cell; signals, watchdog and an orderly end.

Nothing here moves the robot: the robot asks, the cell answers.  A camera that is not there is looked for in the
background, and the robot is told so until it comes.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import secrets
import signal
import time
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator, Mapping
from pathlib import Path
from typing import Any

import structlog

from slabcell.catalogue import Fault
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.errors import SlabcellError
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.app import make_app
from slabcell.service.api.context import ApiContext
from slabcell.service.api.resources.tasks import task_view
from slabcell.service.api.ring import EventRing
from slabcell.service.api.server import listen, serve
from slabcell.service.api.stream import StreamSeats
from slabcell.service.background import Background
from slabcell.service.bench.workbench import Workbench
from slabcell.service.builder import CellParts, open_cell, read_parts
from slabcell.service.bundles import BundleShelf
from slabcell.service.calibrations import CalibrationShelf
from slabcell.service.camera_keeper import CameraKeeper
from slabcell.service.config import CellConfig
from slabcell.service.config_layers import load_config
from slabcell.service.config_reload import Reloader
from slabcell.service.devices import InstanceLock, api_socket, make_camera, state_directory
from slabcell.service.disk_watch import DiskWatch
from slabcell.service.ending import close_camera, ended_in_time
from slabcell.service.event_feed import EventFeed
from slabcell.service.frames import FrameStore
from slabcell.service.history import History
from slabcell.service.ledger_view import LedgerView
from slabcell.service.light_config import LightReport, with_light
from slabcell.service.links import Links
from slabcell.service.metrics import Metrics
from slabcell.service.notify import notify, watchdog_interval_s
from slabcell.service.picture_sets import PictureSets
from slabcell.service.pictures import Pictures
from slabcell.service.robot_link import serve_robot
from slabcell.service.robot_watch import RobotWatch
from slabcell.service.studio import Studio
from slabcell.service.watchdog import feed
from slabcell_drivers.camera import Camera

__all__ = ["run_daemon", "running_cell"]

SOCKET_MODE = 0o660

_log = structlog.get_logger(__name__)


async def run_daemon(path: Path, *, ready: Callable[[tuple[str, int]], None] | None = None) -> None:
    """Run the cell of a configuration file until SIGTERM or SIGINT; ``ready`` is told where robot and cell meet.

    Raises ConfigurationError, CalibrationError, RecipeError, TemporaryError (a second instance) or UnavailableError
    (the address is taken) before anything runs.  After the signal the process itself ends, within 5 s.
    """
    config = load_config(path)
    folder = state_directory(config.state_directory)
    shelf = RecipeShelf(config.recipe, folder)
    calibrations = CalibrationShelf(config.calibration, folder)
    used = {"recipe": shelf.active, "calibration": calibrations.active}
    parts = read_parts(config.model_copy(update=used))
    stopping, reload = asyncio.Event(), asyncio.Event()
    with contextlib.ExitStack() as ending:
        ending.enter_context(_signals({signal.SIGTERM: stopping, signal.SIGINT: stopping, signal.SIGHUP: reload}))
        ending.enter_context(InstanceLock(folder))
        async with running_cell(config, parts, folder) as (context, address, ledger):
            context.config_path = path
            # What was loaded stays: looking through all of it again would hold a robot up for a tenth of a second.
            gc.collect()
            gc.freeze()
            recipe = context.cell.recipe.name
            waits_for = "the robot" if context.cell.calibration else "its first calibration"
            _log.info("ready", cell=config.name, recipe=recipe, robot=f"{address[0]}:{address[1]}", waits_for=waits_for)
            if ready is not None:
                ready(address)
            notify(f"READY=1\nSTATUS=recipe {recipe}, waiting for {waits_for}")
            reloader = Reloader(path, config, context.cell, context.pending_reload, context.tell_config)
            async with _beside(_reloading(reload, reloader), *_watchdog(context.cell, ledger)):
                await stopping.wait()
                ending.enter_context(ended_in_time())
            notify("STOPPING=1")
            _log.info("stopping")


@contextlib.contextmanager
def _signals(events: Mapping[signal.Signals, asyncio.Event]) -> Generator[None]:
    """Have each signal set its event, from the first moment to the last."""
    loop = asyncio.get_running_loop()
    for number, event in events.items():
        loop.add_signal_handler(number, event.set)
    try:
        yield
    finally:
        for number in events:
            loop.remove_signal_handler(number)


async def _reloading(wanted: asyncio.Event, reloader: Reloader) -> None:
    """Read the configuration anew each time it is wanted; the supervisor is told when it begins and ends."""
    while True:
        await wanted.wait()
        wanted.clear()
        notify(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")
        await reloader.reload()
        notify("READY=1")


@contextlib.asynccontextmanager
async def running_cell(
    config: CellConfig, parts: CellParts, folder: Path, *, camera: Camera | None = None
) -> AsyncGenerator[tuple[ApiContext, tuple[str, int], Ledger]]:
    """Give the running cell, where the robot meets it, and its ledger; everything is closed in the end.

    Another ``camera`` than that of the configuration is one that is simulated.  ``parts`` may be of another recipe and
    calibration than the configuration names: what was activated last.
    """
    async with contextlib.AsyncExitStack() as stack:
        history = await History.open(folder / "history.sqlite")
        stack.push_async_callback(history.close)
        epoch = secrets.token_hex(4)
        ring, links, frames = EventRing(epoch), Links(light=config.light is not None), FrameStore(epoch)
        stack.push_async_callback(frames.close)
        feed = EventFeed(ring, history, links, frames)
        links.changed = feed.link_changed
        light = LightReport()
        camera = with_light(camera or make_camera(config.camera), config.light, light)
        stack.push_async_callback(close_camera, camera)
        cell, ledger = await stack.enter_async_context(open_cell(parts, camera, folder))
        stack.callback(cell.subscribe(feed.see))
        light.tell_to(cell.alarms, links)
        view = LedgerView(folder / "ledger.sqlite")
        stack.push_async_callback(view.close)
        robot = RobotWatch(cell, links)
        bundles = BundleShelf(folder / "bundles")
        background = Background(lambda task: feed.add("task", task_view(task, result=False).model_dump(mode="json")))
        recipes = RecipeShelf(config.recipe, folder)
        pictures = Pictures(frames, bundles, history, recipes, PictureSets(folder / "pictures"))
        studio = Studio(Workbench(), pictures, background)
        stack.push_async_callback(studio.close)
        stack.callback(cell.subscribe(studio.bench.see))
        context = ApiContext(
            name=config.name,
            started_s=time.monotonic(),
            cell=cell,
            links=links,
            robot=robot,
            history=history,
            ledger=view,
            ring=ring,
            seats=StreamSeats(config.api.event_clients),
            frames=frames,
            bundles=bundles,
            studio=studio,
            tell_config=lambda content: feed.add("config", content),
            recipes=recipes,
            calibrations=CalibrationShelf(config.calibration, folder),
        )
        metrics = Metrics(context, camera)
        context.metrics = metrics.text
        stack.callback(cell.subscribe(metrics.see))
        keeper = CameraKeeper(camera, cell, links, lambda: cell.calibration)
        context.camera = lambda: keeper.info
        disk = DiskWatch(folder, cell.alarms, links)
        await stack.enter_async_context(_beside(keeper.run(), disk.run(), cell.alarms.tend()))
        socket_path = api_socket(config.api.socket, folder)
        server_socket = listen(socket_path, mode=SOCKET_MODE, group=config.api.group)
        await stack.enter_async_context(serve(make_app(context), server_socket, socket_path))
        stack.callback(ring.close)
        address = await stack.enter_async_context(serve_robot(config, robot, cell.alarms))
        yield context, address, ledger


@contextlib.asynccontextmanager
async def _beside(*works: Coroutine[Any, Any, None]) -> AsyncGenerator[None]:
    """Have something done beside the rest, until the end of the block.  What fails ends the block, and is named.

    A daemon without one of its parts would look alive and not be: it ends in order, and the supervisor starts it anew.
    Raises SlabcellError for what has failed.
    """
    block = asyncio.current_task()
    failed: list[tuple[str, BaseException]] = []

    def report(task: asyncio.Task[None]) -> None:
        if task.cancelled() or (error := task.exception()) is None:
            return
        _log.error("a part of the daemon ended", part=task.get_name(), exc_info=error)
        if not failed and block is not None:
            block.cancel()
        failed.append((task.get_name(), error))

    tasks = [asyncio.create_task(work, name=f"slabcell-{work.__qualname__}") for work in works]
    for task in tasks:
        task.add_done_callback(report)
    try:
        yield
    except asyncio.CancelledError:
        if not failed or block is None or block.uncancel() > 0:
            raise
    finally:
        for task in tasks:
            task.remove_done_callback(report)
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if failed:
        part, error = failed[0]
        msg = f"{part} ended: {type(error).__name__}: {error}"
        raise SlabcellError(msg, number=Fault.INTERNAL) from error


def _watchdog(cell: Cell, ledger: Ledger) -> tuple[Coroutine[Any, Any, None], ...]:
    """Return what feeds the supervisor's watchdog, if it wants that."""
    interval_s = watchdog_interval_s()
    return () if interval_s is None else (feed(cell, ledger, interval_s),)
