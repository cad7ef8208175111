"""`slabcell events`: what happens in the running cell?"""

import json
from typing import Annotated

import typer

from slabcell.cli.talk import Socket, client

__all__ = ["events_command"]


def events_command(
    kind: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="Only this kind, such as alarm; may be repeated.")
    ] = None,
    after: Annotated[str | None, typer.Option("--after", metavar="ID", help="What followed this event.")] = None,
    count: Annotated[int | None, typer.Option("--count", min=1, help="End after so many.")] = None,
    socket: Socket = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object a line.")] = False,
) -> None:
    """Follow events as they happen, until interrupted."""
    for number, event in enumerate(client(socket).events(kinds=kind or (), after=after), start=1):
        if as_json:
            typer.echo(json.dumps({"id": event.id, "kind": event.kind, "data": event.data}))
        else:
            words = "  ".join(
                f"{key}={value}" for key, value in event.data.items() if not isinstance(value, (dict, list))
            )
            typer.echo(f"{event.kind:9} {words}")
        if number == count:
            return
