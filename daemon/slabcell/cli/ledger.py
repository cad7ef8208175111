"""`slabcell ledger`: what was offered to the robot, what became of it, and what does a person say of the rest?"""

import json
import os
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from slabcell.cell.ledger import LedgerError, LedgerFile
from slabcell.cell.ledger_export import export_document, read_export, restore, set_aside, write_export
from slabcell.cell.records import OfferState
from slabcell.cli.talk import make_console
from slabcell.service.api.client import ApiClient, default_socket
from slabcell.service.devices import InstanceLock

__all__ = ["ledger_app"]

ledger_app = typer.Typer(help="Show, export and settle the record of offers.", no_args_is_help=True)

FILE_NAME = "ledger.sqlite"
STATE_DIRECTORY = Path("/var/lib/slabcell")
"""Where the service keeps it."""

Where = Annotated[
    Path | None,
    typer.Option(
        "--ledger",
        metavar="FILE",
        help=f"The ledger; the default is {FILE_NAME} in $STATE_DIRECTORY, or in {STATE_DIRECTORY}.",
    ),
]


class Verdict(StrEnum):
    """What a person saw."""

    PLACED = "placed"
    FAILED = "failed"


@ledger_app.command()
def show(
    ledger: Where = None,
    job: Annotated[int | None, typer.Option("--job", help="Number of a job; the default is the last one.")] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show a job: every result, its slot, and what became of it."""
    book = LedgerFile(_existing(ledger), copy=True)
    try:
        jobs = book.rows("jobs")
        chosen = [row for row in jobs if job is None or row["job_id"] == job][-1:]
        if not chosen and job is not None:
            msg = f"{book.path}: holds no job {job}; it has jobs 1 to {len(jobs)}"
            raise LedgerError(msg)
        number = int(str(chosen[0]["job_id"])) if chosen else 0
        offers = book.rows("offers", number)
        placements = {row["slot"]: row for row in book.rows("placements", number)}
    finally:
        book.close()
    if as_json:
        document = {
            "schema": "slabcell.ledger-job/1",
            "job": chosen[0] if chosen else None,
            "offers": offers,
            "placements": list(placements.values()),
        }
        typer.echo(json.dumps(document))
        return
    if not chosen:
        typer.echo(f"{book.path}: no job yet")
        return
    head = chosen[0]
    table = Table(
        "result", "slot", "state", "since (UTC)", "why", title=f"job {number}, recipe {head['recipe']}: {head['state']}"
    )
    for row in offers:
        style = "bold red" if row["state"] == OfferState.UNKNOWN else ""
        cells = (str(row[key]) for key in ("result_id", "slot", "state", "changed_utc", "reason"))
        table.add_row(*cells, style=style)
    make_console().print(table)
    laid = sum(row["state"] == OfferState.PLACED for row in offers)
    typer.echo(f"{laid} of {head['slots']} slots are laid")


@ledger_app.command()
def export(
    out: Annotated[Path, typer.Argument(metavar="FILE", help="JSON file to write.")], ledger: Where = None
) -> None:
    """Write the whole ledger as JSON: a backup, and for evaluation elsewhere."""
    book = LedgerFile(_existing(ledger), copy=True)
    try:
        document = export_document(book)
    finally:
        book.close()
    write_export(out, document)
    typer.echo(str(out))


@ledger_app.command("restore")
def restore_command(
    source: Annotated[Path, typer.Argument(metavar="EXPORT", help="JSON file of an export.")], ledger: Where = None
) -> None:
    """Make a ledger of an export.  A ledger that is there is set aside, not deleted.  Stop the service first.

    Refused while a daemon runs: it would go on writing to the one that was set aside.
    """
    document = read_export(source)
    path = _path(ledger)
    with InstanceLock(path.parent):
        restored = path.with_name(f"{path.name}.restored")  # the one that is there stays until this one is whole
        restored.unlink(missing_ok=True)
        restore(restored, document, str(source))
        if os.geteuid() == 0:  # the daemon is not root, and has to write to it
            owner = path.parent.stat()
            os.chown(restored, owner.st_uid, owner.st_gid)
        if path.exists():
            typer.echo(f"set aside: {set_aside(path, now=datetime.now(UTC))}")
        restored.replace(path)
    typer.echo(str(path))


@ledger_app.command()
def resolve(
    result: Annotated[int, typer.Argument(metavar="RESULT", help="Number of a result that is unknown.")],
    verdict: Annotated[Verdict, typer.Argument(help="placed: the slab lies in its slot; failed: it does not.")],
    ledger: Where = None,
) -> None:
    """Say what became of a slab of which nobody knows.  Look at its slot first.

    A running daemon is told, so that it goes on; the file itself is changed only where no daemon runs.
    """
    if ledger is None and default_socket().exists():
        typer.echo(ApiClient().post(f"/v1/ledger/{result}/resolve", {"verdict": verdict.value})["detail"])
        return
    path = _existing(ledger)
    with InstanceLock(path.parent):
        _resolve_in_file(path, result, verdict)


def _resolve_in_file(path: Path, result: int, verdict: Verdict) -> None:
    book = LedgerFile(path)
    try:
        offer = book.offer(result)
        if offer is None or offer.state is not OfferState.UNKNOWN:
            known = f"is {offer.state}" if offer else "is not in the ledger"
            msg = f"result {result} {known}: only an unknown result can be resolved"
            raise LedgerError(msg)
        after = book.move(result, OfferState(verdict.value), reason="seen by a person")
    finally:
        book.close()
    typer.echo(f"result {result}, slot {after.slot}: {after.state}")


def _path(ledger: Path | None) -> Path:
    if ledger is not None:
        return ledger
    state = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(state or STATE_DIRECTORY) / FILE_NAME


def _existing(ledger: Path | None) -> Path:
    path = _path(ledger)
    if not path.exists():
        msg = f"{path}: there is no such ledger; name the cell's own with --ledger FILE"
        raise LedgerError(msg)
    return path
