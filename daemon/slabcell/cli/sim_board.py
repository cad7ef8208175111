"""`slabcell sim board`: show the calibration board to the camera of a simulated cell that runs."""

from typing import Annotated

import typer

from slabcell.cli.talk import AsJson, Socket, client, print_json

__all__ = ["board_command"]


def board_command(
    place: Annotated[str, typer.Argument(metavar="held|table|flange|away", help="Where the board is to be.")],
    number: Annotated[int, typer.Argument(metavar="NUMBER", min=0, help="Which pose of many, from 0.")] = 0,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Show the calibration board to the camera of `slabcell demo --hmi`, or take it away."""
    document = client(socket).post("/v1/simulation/board", {"place": place, "number": number})
    if as_json:
        print_json(document)
        return
    typer.echo(f"{document['board']}, {document['thickness_mm']:g} mm thick: {document['place']} {document['number']}")
    if document["flange"] is not None:
        typer.echo(",".join(f"{value:g}" for value in document["flange"]))
