"""What do the verbs that talk to a running daemon share?  Their options, and how they print."""

import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from slabcell.service.api.client import ApiClient

__all__ = ["AsJson", "Socket", "client", "given", "make_console", "print_json", "print_page", "print_parts", "seconds"]

UNBOUNDED = 1000
"""Columns of what is no terminal."""

Socket = Annotated[
    Path | None,
    typer.Option(
        "--socket",
        metavar="FILE",
        help="The daemon's socket; the default is $SLABCELL_SOCKET, or /run/slabcell/api.sock.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


def client(path: Path | None, *, timeout_s: float = 60.0) -> ApiClient:
    """Return a client for the socket that was named, or the usual one."""
    return ApiClient(path, timeout_s=timeout_s)


def make_console() -> Console:
    """Return what tables and lines are printed to: as wide as the terminal; into a file or a pipe nothing is cut off.

    Texts from outside may hold brackets: none is taken for markup.
    """
    unbounded = not sys.stdout.isatty() and "COLUMNS" not in os.environ
    return Console(width=UNBOUNDED if unbounded else None, markup=False, highlight=False)


def given(query: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a query that somebody has named."""
    return {name: value for name, value in query.items() if value is not None}


def print_page(table: Table, before: int | None) -> None:
    """Print one page of a list, and how the next one is asked for, if there is one."""
    make_console().print(table)
    if before is not None:
        typer.echo(f"older ones: --before {before}")


def print_json(document: Mapping[str, Any]) -> None:
    """Print one object on one line."""
    typer.echo(json.dumps(document))


def print_parts(located: Mapping[str, Any]) -> None:
    """Print the parts of a `slabcell.locate/1` document as a table, and below it what was refused."""
    table = Table("slot", "score", "residual mm", "pick x mm", "pick y mm", "pick a °")
    for part in located["parts"]:
        pick = part["pick"]
        numbers = (part["score"], part["residual_mm"], pick["x_mm"], pick["y_mm"], pick["a_deg"])
        table.add_row(str(part["slot"]), *(f"{number:.3f}" for number in numbers))
    make_console().print(table)
    for blob in located["rejected"]:
        typer.echo(f"refused at {blob['image']['u']:.0f}, {blob['image']['v']:.0f}: {blob['reason']}: {blob['detail']}")


def seconds(duration_s: float) -> str:
    """Return a duration as people say it."""
    if duration_s < 60:
        return f"{duration_s:.1f} s"
    if duration_s < 3600:
        return f"{duration_s / 60:.0f} min"
    return f"{duration_s / 3600:.1f} h"
