"""`slabcell trigger` and `slabcell verify`: what does the camera see now?"""

from typing import Any

import typer
from rich.table import Table

from slabcell.cli.talk import AsJson, Socket, client, make_console, print_json, print_parts

__all__ = ["trigger_command", "verify_command"]


def trigger_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """Take a picture and see what could be laid.  Nothing is offered to the robot, nothing is written.

    Refused while a robot is connected, unless the cell is halted: no robot shall have to wait.
    """
    api = client(socket)
    cycle = api.post("/v1/trigger")
    frame = api.get("/v1/frames/latest")
    if as_json:
        print_json({"schema": "slabcell.trigger/1", "cycle": cycle, "frame": frame})
        return
    overlay: dict[str, Any] = frame["overlay"] or {"parts": [], "rejected": [], "empty_slots": []}
    print_parts(overlay)
    for item in cycle["refused"]:
        typer.echo(f"slot {item['slot']} not planned [{item['number']}]: {item['detail']}")
    if overlay["empty_slots"]:
        typer.echo(f"free slots without a slab: {', '.join(map(str, overlay['empty_slots']))}")


def verify_command(socket: Socket = None, *, as_json: AsJson = False) -> None:
    """Measure how the slabs of the present job lie.  The arm must be out of the camera's view."""
    document = client(socket).post("/v1/verify")
    if as_json:
        print_json(document)
        return
    table = Table("slot", "found", "dx mm", "dy mm", "dθ °")
    for item in document["placements"]:
        numbers = (item[key] for key in ("dx_mm", "dy_mm", "da_deg"))
        table.add_row(
            str(item["slot"]), "yes" if item["found"] else "no", *("" if n is None else f"{n:+.3f}" for n in numbers)
        )
    make_console().print(table)
