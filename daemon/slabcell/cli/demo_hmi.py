"""`slabcell demo --hmi`: the simulated cell, and its web pages in a process of their own, as on a cell PC."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Final

from slabcell.errors import SlabcellError
from slabcell.service.demo import Progress
from slabcell.service.demo_cell import DemoCellOptions, run_demo_cell

__all__ = ["show_demo"]

END_S: Final = 10.0
COMMAND: Final = (sys.executable, "-c", "from slabcell.cli import main; main()")


async def show_demo(options: DemoCellOptions, progress: Progress, port: int) -> None:
    """Run cell and pages until SIGTERM or SIGINT.  Raises SlabcellError."""
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)

    out = options.out.absolute()

    async def pages(socket: Path) -> None:
        with as_file(files("slabcell") / "data" / "config" / "demo.toml") as config:
            environment = {
                **os.environ,
                "SLABCELL__API__SOCKET": str(socket),
                "SLABCELL__HMI__STATE_DIRECTORY": str(out / "hmi"),
                "SLABCELL__HMI__PORT": str(port),
            }
            process = await asyncio.create_subprocess_exec(
                *COMMAND, "hmi", "--config", str(config), env=environment, start_new_session=True
            )
            ended = asyncio.create_task(process.wait(), name="slabcell-demo-hmi")
            stopped = asyncio.create_task(stopping.wait(), name="slabcell-demo-stop")
            try:
                await asyncio.wait({ended, stopped}, return_when=asyncio.FIRST_COMPLETED)
                if ended.done():
                    msg = f"the pages ended with exit code {ended.result()}; the lines above say why"
                    raise SlabcellError(msg)
            finally:
                stopped.cancel()
                with contextlib.suppress(ProcessLookupError):
                    process.terminate()
                    await asyncio.wait({ended}, timeout=END_S)
                    process.kill()
                await asyncio.gather(ended, stopped, return_exceptions=True)

    await run_demo_cell(replace(options, out=out), progress, pages)
