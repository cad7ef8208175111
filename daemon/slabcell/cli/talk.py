"""What do the verbs that talk to a running daemon share?  Their options, and how they print."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from slabcell.errors import SlabcellError, UsageError
from slabcell.service.api.client import ApiClient

__all__ = ["AsJson", "Socket", "client", "print_json", "read_file", "seconds", "write_file"]

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


def print_json(document: Mapping[str, Any]) -> None:
    """Print one object on one line."""
    typer.echo(json.dumps(document))


def seconds(duration_s: float) -> str:
    """Return a duration as people say it."""
    if duration_s < 60:
        return f"{duration_s:.1f} s"
    if duration_s < 3600:
        return f"{duration_s / 60:.0f} min"
    return f"{duration_s / 3600:.1f} h"


def read_file(path: Path) -> bytes:
    """Return what a file holds.  Raises UsageError."""
    try:
        return path.read_bytes()
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise UsageError(msg) from error


def write_file(path: Path, content: bytes) -> None:
    """Write a file, and the folder that it is in.  Raises SlabcellError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror}"
        raise SlabcellError(msg) from error
