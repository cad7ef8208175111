"""How does a simulated cell stay alive, for the HMI to look at?  Job after job, in the robot's own time.

The daemon is the one that runs on a cell PC: control API, history, alarms.  Camera and robot belong to the simulated
world.  When a template is full, a person who is not there takes it away and strews new slabs.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from slabcell.calibration import Calibration, save_calibration
from slabcell.service.api.context import ApiContext
from slabcell.service.builder import CellParts, cell_settings
from slabcell.service.config import CellConfig
from slabcell.service.daemon import running_cell
from slabcell.service.demo import Progress, demo_folder, read_demo_parts
from slabcell.service.demo_pictures import grade_newest, store_pictures
from slabcell.service.simulated import BoardPoses, SimulatedCell, calibrate_from_boards
from slabcell.service.simulated_board import BoardStand
from slabcell_drivers.krc import RunResult, SoftwareKrc

__all__ = ["DemoCell", "DemoCellOptions", "open_demo_cell", "run_demo_cell"]

PROGRAM = "SlabCell"
JOB_TIMEOUT_S = 3600.0
BETWEEN_JOBS_S = 4.0
AFTER_A_STOP_S = 2.0

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class DemoCellOptions:
    """Which scene, how strewn, where files go, and how fast the robot is: 1 is as fast as the arm, None at once."""

    scene: str
    seed: int
    out: Path
    speed: float | None = 2.0
    calibration: Calibration | None = None
    """None: made from pictures of a board first, as in the demo."""


class DemoCell:
    """A simulated cell that lives, and its robot, which lays a template when it is told to."""

    def __init__(
        self,
        simulated: SimulatedCell,
        context: ApiContext,
        socket: Path,
        address: tuple[str, int],
        options: DemoCellOptions,
    ) -> None:
        self.simulated = simulated
        self.context = context
        self.socket = socket
        """Of the control API."""
        self.address = address
        """Where the robot meets the cell."""
        self._speed = options.speed
        self._seed = options.seed
        self._controller = self._switch_on()

    def _switch_on(self) -> SoftwareKrc:
        return self.simulated.controller(self.address, seed=self._seed, speed=self._speed)

    def strew(self) -> None:
        """Take what was laid away and strew new slabs; only while the robot's program does not run."""
        self._seed += 1
        self.simulated.strew(self._seed)
        self._controller = self._switch_on()

    async def lay(self) -> RunResult:
        """Run the robot's program to its end."""
        controller = self._controller
        running = asyncio.create_task(
            asyncio.to_thread(controller.run, PROGRAM, max_wall_s=JOB_TIMEOUT_S), name="slabcell-demo-krc"
        )
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            controller.cancel()
            await running
            raise


@asynccontextmanager
async def open_demo_cell(options: DemoCellOptions, progress: Progress) -> AsyncGenerator[DemoCell]:
    """Give a cell that lives until the end of the block.  Raises SlabcellError."""
    parts = read_demo_parts(options.scene)
    out = demo_folder(options.out)
    simulated = SimulatedCell(parts.scene, options.seed, parts.arm, parts.config.robot.tool.to_frame())
    calibration = options.calibration
    if calibration is None:
        boards = BoardPoses.of(parts.scene, options.seed)
        progress.stage("calibrating from pictures of a board", len(boards))
        calibration, _, _ = await asyncio.to_thread(
            calibrate_from_boards, parts.scene, boards, options.seed, progress.advance
        )
    save_calibration(out / "calibration.json", calibration)
    socket = out / "api.sock"
    files = {"api": parts.config.api.model_copy(update={"socket": socket}), "calibration": out / "calibration.json"}
    config = parts.config.model_copy(update=files)
    cell_parts = CellParts(calibration, parts.recipe, parts.arm, cell_settings(config))
    config_file = out / "cell.toml"
    config_file.write_text(config_text(config), encoding="utf-8")
    async with running_cell(config, cell_parts, out, camera=simulated.camera) as (context, address, _):
        context.config_path = config_file
        context.board = BoardStand(simulated, options.seed)
        await asyncio.to_thread(store_pictures, context.studio.pictures.sets, parts.scene, options.seed)
        yield DemoCell(simulated, context, socket, address, options)


async def run_demo_cell(
    options: DemoCellOptions, progress: Progress, meanwhile: Callable[[Path], Awaitable[None]]
) -> None:
    """Lay job after job as long as ``meanwhile``, which is told the API's socket.  Raises SlabcellError."""
    async with open_demo_cell(options, progress) as cell:
        progress.stage("laying slabs, until interrupted")
        working = asyncio.create_task(_lay_on(cell, progress), name="slabcell-demo-robot")
        try:
            await meanwhile(cell.socket)
        finally:
            working.cancel()
            await asyncio.gather(working, return_exceptions=True)


async def _lay_on(cell: DemoCell, progress: Progress) -> None:
    while True:
        result = await cell.lay()
        _log.info("robot program ended", status=result.status, message=result.message)
        progress.advance(f"robot program: {result.status} {result.message}".rstrip())
        if result.status == "done":
            await grade_newest(cell.context)
            await asyncio.sleep(BETWEEN_JOBS_S)
            cell.strew()
        else:
            await asyncio.sleep(AFTER_A_STOP_S)


def config_text(config: CellConfig) -> str:
    """Return the configuration of a demo as a file beside its state, for `slabcell doctor` and the HMI."""
    content = config.model_dump(mode="json", exclude_defaults=True)
    content |= {"recipe": str(config.recipe.absolute()), "calibration": "calibration.json", "state_directory": "."}
    return "\n".join(["# Written by slabcell demo.", *_table(content, "")]) + "\n"


def _table(content: dict[str, Any], name: str) -> list[str]:
    """Return a table as TOML, whose plain values are written as in JSON."""
    plain = {key: value for key, value in content.items() if not isinstance(value, dict) and value is not None}
    lines = [f"[{name}]"] if name and plain else []
    lines += [f"{key} = {json.dumps(value)}" for key, value in plain.items()]
    for key, value in content.items():
        if isinstance(value, dict):
            lines += _table(value, f"{name}.{key}" if name else key)  # pyright: ignore[reportUnknownArgumentType]  (JSON)
    return lines
