"""`slabcell job`: how far is the job, and which were there before?"""

from typing import Annotated, Any

import typer
from rich.table import Table

from slabcell.cli.talk import AsJson, Socket, client, given, make_console, print_json, print_page

__all__ = ["job_app"]

job_app = typer.Typer(help="Show jobs, and what became of their slabs; close one that is open.", no_args_is_help=True)


@job_app.command()
def show(
    job: Annotated[int | None, typer.Argument(metavar="JOB", help="Its number; the present one if left out.")] = None,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """Show a job: every result, its slot, what became of it, and how the slab lies."""
    document = client(socket).get("/v1/jobs/current" if job is None else f"/v1/jobs/{job}")
    if as_json:
        print_json(document)
        return
    head = document["job"]
    lying = {item["slot"]: item for item in document["placements"]}
    table = Table(
        *("result", "slot", "state", "dx mm", "dy mm", "dθ °", "why"),
        title=f"job {head['job']}, recipe {head['recipe']}: {head['state']}",
    )
    for offer in document["offers"]:
        measured = lying.get(offer["slot"]) if offer["state"] == "placed" else None
        offsets = [_number(measured, key) for key in ("dx_mm", "dy_mm", "da_deg")]
        style = "bold red" if offer["state"] == "unknown" else ""
        table.add_row(str(offer["result"]), str(offer["slot"]), offer["state"], *offsets, offer["reason"], style=style)
    make_console().print(table)
    slots = head["slots"]
    typer.echo(f"{len(slots['laid'])} of {slots['total']} slots are laid, {len(slots['free'])} are free")
    dx_mm, dy_mm = head["correction_x_mm"], head["correction_y_mm"]
    if dx_mm or dy_mm:
        typer.echo(f"every place is moved by dx {dx_mm:+.3f} mm, dy {dy_mm:+.3f} mm, as the last job was off")


def _number(measured: dict[str, Any] | None, key: str) -> str:
    return "" if measured is None or measured[key] is None else f"{measured[key]:+.3f}"


@job_app.command()
def abandon(socket: Socket = None) -> None:
    """Close the open job before it is complete; the robot must not be at work on a slab of it."""
    typer.echo(client(socket).post("/v1/jobs/current/abandon")["detail"])


@job_app.command("list")
def list_command(
    state: Annotated[str | None, typer.Option("--state", help="Only open, complete or abandoned ones.")] = None,
    before: Annotated[int | None, typer.Option("--before", help="Only jobs with a number below this.")] = None,
    limit: Annotated[int, typer.Option("--limit", min=1, max=100, help="At most so many.")] = 20,
    socket: Socket = None,
    *,
    as_json: AsJson = False,
) -> None:
    """List jobs, the newest first."""
    document = client(socket).get("/v1/jobs", **given({"state": state, "before": before, "limit": limit}))
    if as_json:
        print_json(document)
        return
    table = Table("job", "recipe", "state", "laid", "began (UTC)", "ended (UTC)")
    for job in document["jobs"]:
        laid = f"{len(job['slots']['laid'])} of {job['slots']['total']}"
        table.add_row(str(job["job"]), job["recipe"], job["state"], laid, job["began"], job["ended"] or "")
    print_page(table, document["before"])
