"""`slabcell cell`: halt the running cell, and have it go on."""

import typer

from slabcell.cli.talk import Socket, client

__all__ = ["cell_app"]

cell_app = typer.Typer(
    help="Halt the running cell, have it go on, step, or clear an error.  Nothing here moves the robot.",
    no_args_is_help=True,
)


@cell_app.command()
def stop(socket: Socket = None) -> None:
    """Halt: offer nothing any more.  What the robot holds it may still lay down.  This is no emergency stop."""
    typer.echo(client(socket).post("/v1/stop")["detail"])


@cell_app.command()
def start(socket: Socket = None) -> None:
    """Leave the halted state.  The robot has to trigger."""
    typer.echo(client(socket).post("/v1/start")["detail"])


@cell_app.command()
def step(socket: Socket = None) -> None:
    """Go on for one slab, then halt."""
    typer.echo(client(socket).post("/v1/step")["detail"])


@cell_app.command()
def clear(socket: Socket = None) -> None:
    """Leave the error state, its cause being removed."""
    typer.echo(client(socket).post("/v1/clear")["detail"])
