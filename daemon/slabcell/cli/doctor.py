"""`slabcell doctor`: what is wrong with this cell, and what to do."""

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer

from slabcell.service.doctor import Finding, Patient, Severity, examine
from slabcell.service.doctor_checks import CHECKS

__all__ = ["doctor_command"]

_MARKS: Final = {Severity.OK: "✓", Severity.NOTE: "·", Severity.WARNING: "!", Severity.ERROR: "✗"}


def doctor_command(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The cell's configuration.")] = Path(
        "/etc/slabcell/cell.toml"
    ),
    root: Annotated[Path, typer.Option("--root", metavar="DIR", help="Where the service is installed.")] = Path("/"),
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Look at files, network, camera, service and daemon; say what is wrong and what to do.

    Nothing is changed.  Exit code 1 if there is an error, with which the cell does not work; warnings give 0.
    """
    found: list[Finding] = []
    for finding in examine(Patient(config, root), CHECKS):
        found.append(finding)
        if not as_json:
            _print(finding)
    counts = Counter(finding.severity for finding in found)
    if as_json:
        document = {
            "schema": "slabcell.doctor/1",
            "config": str(config),
            "findings": [asdict(finding) for finding in found],
            "counts": {severity.value: counts[severity] for severity in Severity},
        }
        typer.echo(json.dumps(document))
    else:
        typer.echo(f"{counts[Severity.ERROR]} errors, {counts[Severity.WARNING]} warnings")
    if counts[Severity.ERROR]:
        raise typer.Exit(1)


def _print(finding: Finding) -> None:
    typer.echo(f"{_MARKS[finding.severity]} D{finding.number:02d} {finding.subject}: {finding.detail}")
    if finding.remedy:
        typer.echo(f"      {finding.remedy}")
    if finding.severity in {Severity.WARNING, Severity.ERROR}:
        typer.echo(f"      docs/{finding.docs}")
