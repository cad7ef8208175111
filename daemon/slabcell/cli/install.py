"""`slabcell install`: lay this version out on the cell PC, or take it away."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from slabcell import __version__
from slabcell.service.install import Report, install, uninstall

__all__ = ["install_command"]


def install_command(
    root: Annotated[
        Path, typer.Option("--root", metavar="DIR", help="Lay it out below this folder instead of below /.")
    ] = Path("/"),
    *,
    remove: Annotated[
        bool, typer.Option("--uninstall", help="Take away what was laid; what was edited stays.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Lay this version out under /opt/slabcell, with its service, user and configuration.

    Edited configuration is never overwritten, and doing it again changes nothing.  Nothing is started.
    """
    report = uninstall(root) if remove else install(root)
    if as_json:
        document = {"schema": "slabcell.install-report/1", "version": __version__, "root": str(root), **asdict(report)}
        typer.echo(json.dumps(document))
        return
    _print(report)


def _print(report: Report) -> None:
    for word, paths in (("laid", report.laid), ("removed", report.removed), ("kept, edited", report.kept)):
        for path in paths:
            typer.echo(f"{word:13} /{path}")
    if not (report.laid or report.removed):
        typer.echo("everything lies as it should")
    for warning in report.warnings:
        typer.echo(f"warning: {warning}", err=True)
    if report.next_steps:
        typer.echo("next, as root:")
        for step in report.next_steps:
            typer.echo(f"  {step}")
