"""`slabcell cycle`: what did the cell do, and how well do its slabs lie?  Cycles out of the running cell's history."""

import csv
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from slabcell.cli.files import write_file
from slabcell.cli.talk import AsJson, Socket, client, given, print_json, print_page

__all__ = ["cycle_app"]

cycle_app = typer.Typer(
    help="Show cycles, save what is kept of them, and how slabs were measured to lie.", no_args_is_help=True
)

Number = Annotated[int, typer.Argument(metavar="CYCLE", help="Its number.")]
MEASURED = ("at", "job", "slot", "found", "dx_mm", "dy_mm", "da_deg", "residual_mm")


@cycle_app.command("list")
def list_command(
    job: Annotated[int | None, typer.Option("--job", help="Only cycles of this job.")] = None,
    code: Annotated[int | None, typer.Option("--code", help="Only with this code.")] = None,
    since: Annotated[
        str | None, typer.Option("--since", help="Only cycles that began then or later, ISO 8601.")
    ] = None,
    until: Annotated[str | None, typer.Option("--until", help="Only cycles that began before, ISO 8601.")] = None,
    before: Annotated[int | None, typer.Option("--before", help="Only cycles with a number below this.")] = None,
    limit: Annotated[int, typer.Option("--limit", min=1, max=100, help="At most so many.")] = 20,
    socket: Socket = None,
    *,
    failed: Annotated[bool, typer.Option("--failed", help="Only cycles that ended with an error's number.")] = False,
    as_json: AsJson = False,
) -> None:
    """List ended cycles, the newest first."""
    query = {"job": job, "code": code, "since": since, "until": until, "before": before, "limit": limit}
    document = client(socket).get("/v1/cycles", failed=failed, **given(query))
    if as_json:
        print_json(document)
        return
    table = Table("cycle", "began (UTC)", "job", "outcome", "ms", "kept")
    for cycle in document["cycles"]:
        total = cycle["times_ms"].get("total")
        table.add_row(
            str(cycle["cycle"]),
            cycle["began"],
            str(cycle["job"] or ""),
            _outcome(cycle),
            "" if total is None else f"{total:.0f}",
            "yes" if cycle["bundle"] else "no",
        )
    print_page(table, document["before"])


@cycle_app.command("show")
def show_command(cycle: Number, socket: Socket = None, *, as_json: AsJson = False) -> None:
    """Show one cycle: its stages, what it offered and what it refused."""
    document = client(socket).get(f"/v1/cycles/{cycle}")
    if as_json:
        print_json(document)
        return
    typer.echo(f"cycle {cycle}, began {document['began']}: {_outcome(document)}")
    typer.echo(", ".join(f"{name} {value:.1f} ms" for name, value in document["times_ms"].items()))
    for offer in document["offers"]:
        pick = offer["pick"]
        typer.echo(f"slot {offer['slot']}: pick {pick['x_mm']:.3f} {pick['y_mm']:.3f} mm, {pick['a_deg']:.3f}°")
    for item in document["refused"]:
        typer.echo(f"slot {item['slot']} not offered [{item['number']}]: {item['detail']}")


@cycle_app.command("save")
def save_command(
    cycle: Number,
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The file that is written.")],
    file: Annotated[
        str | None, typer.Option("--file", help="One file of it, such as frame.png or as-built.csv; none: the bundle.")
    ] = None,
    socket: Socket = None,
) -> None:
    """Save what is kept of a cycle: its bundle, for `slabcell replay`, or one file of it."""
    path = f"/v1/cycles/{cycle}/bundle" if file is None else f"/v1/cycles/{cycle}/files/{file}"
    write_file(out, client(socket).fetch(path).content)
    typer.echo(out)


@cycle_app.command("placements")
def placements_command(
    job: Annotated[int | None, typer.Option("--job", help="Only of this job.")] = None,
    slot: Annotated[int | None, typer.Option("--slot", help="Only of this slot.")] = None,
    before: Annotated[int | None, typer.Option("--before", help="Only measurements with an id below this.")] = None,
    limit: Annotated[int, typer.Option("--limit", min=1, max=5000, help="At most so many.")] = 500,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Print how slabs were measured to lie, as CSV, the newest first: placed minus nominal, in the assembly frame."""
    query = {"job": job, "slot": slot, "before": before, "limit": limit}
    document = client(socket).get("/v1/placements", **given(query))
    if as_json:
        print_json(document)
        return
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(MEASURED)
    for row in document["measurements"]:
        table.writerow([row[name] for name in MEASURED])


@cycle_app.command("picture")
def picture_command(
    out: Annotated[Path, typer.Argument(metavar="OUT.png", help="The file that is written.")],
    socket: Socket = None,
    *,
    new: Annotated[bool, typer.Option("--new", help="Take one first; nothing is looked for in it.")] = False,
) -> None:
    """Save the newest picture, lossless."""
    api = client(socket)
    if new:
        api.post("/v1/frames/take")
    write_file(out, api.fetch("/v1/frames/latest.png").content)
    typer.echo(out)


def _outcome(cycle: dict[str, Any]) -> str:
    if cycle["code"] >= 1000:
        return f"{cycle['code']} {cycle['message']}"
    if cycle["verification"]:
        found = sum(bool(item["found"]) for item in cycle["placements"])
        return f"measured, {found} of {len(cycle['placements'])} lie"
    return f"{cycle['found']} found, {cycle['rejected']} refused"
