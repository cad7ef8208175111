"""`slabcell run`: the cell as a daemon."""

import asyncio
import faulthandler
import sys
from pathlib import Path
from typing import Annotated

import typer

from slabcell.logs import log_to_stream
from slabcell.service.daemon import run_daemon

__all__ = ["run_command"]


def run_command(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The cell's configuration.")] = Path(
        "/etc/slabcell/cell.toml"
    ),
) -> None:
    """Run the cell until SIGTERM: wait for the robot, answer it, keep the ledger.

    Says where the robot may connect once it is ready.  Logs go to standard error, for the journal.
    """
    faulthandler.enable()  # a watchdog that is not fed ends us with SIGABRT: the journal then says where threads stood
    log_to_stream(sys.stderr)
    asyncio.run(
        run_daemon(config, ready=lambda address: typer.echo(f"ready for the robot at {address[0]}:{address[1]}"))
    )
