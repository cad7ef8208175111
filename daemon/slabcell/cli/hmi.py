"""`slabcell hmi`: the web pages, a process of its own beside the daemon."""

import asyncio
import sys
from pathlib import Path
from typing import Annotated

import typer

from slabcell.cli.hmi_users import audit_command, user_app
from slabcell.hmi.context import HmiOptions
from slabcell.hmi.server import run_hmi
from slabcell.hmi.settings import read_options
from slabcell.logs import log_to_stream

__all__ = ["hmi_app"]

hmi_app = typer.Typer(no_args_is_help=False, help="Serve the web pages, and keep their users.")
hmi_app.add_typer(user_app, name="user")
hmi_app.command("audit")(audit_command)
CONFIG = Path("/etc/slabcell/cell.toml")
Config = Annotated[Path, typer.Option("--config", metavar="FILE", help="The cell's configuration.")]


@hmi_app.callback(invoke_without_command=True)
def hmi_command(context: typer.Context, config: Config = CONFIG) -> None:
    """Serve the web pages of the cell until SIGTERM.

    Says which address to open, and at the first start the token with which the first admin is made.
    """
    if context.invoked_subcommand is None:
        log_to_stream(sys.stderr)
        serve(read_options(config))


def serve(options: HmiOptions) -> None:
    """Serve, and say where."""
    asyncio.run(run_hmi(options, _opened))


def _opened(address: str, token: str) -> None:
    typer.echo(f"open {address}")
    if token:
        typer.echo(f"nobody can log in yet; the first admin is made with this token: {token}")
    sys.stdout.flush()
