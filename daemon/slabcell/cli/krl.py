"""`slabcell krl`: would the controller take these programs, and which files go onto it?"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from slabcell.cli.files import read_file
from slabcell.cli.krl_export import export_command
from slabcell.errors import UsageError
from slabcell_drivers.krc.eki_check import check_channels
from slabcell_drivers.krc.loading import ENDINGS
from slabcell_drivers.krc.static import check as check_sources
from slabcell_drivers.krc.syntax import Diagnostic
from slabcell_drivers.robot.eki import consistency

__all__ = ["krl_app"]

MAX_FILE_BYTES = 32 * 1024 * 1024

krl_app = typer.Typer(help="Check the robot programs, and write them for a controller.", no_args_is_help=True)
krl_app.command("export")(export_command)


@krl_app.command()
def check(
    paths: Annotated[list[Path], typer.Argument(help="KRL and EKI files, and folders of them")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Say what a controller's compiler would, file by file, and whether channels and programs fit.

    Exit code 1 if there is an error; warnings alone end with 0.
    """
    sources = _read(paths)
    found = check_sources(sources) + check_channels(sources)
    found += [
        Diagnostic(f.file, f.line, 1, f.severity, f.rule, f.message)
        for f in (consistency.check(sources) if any(n.lower().endswith(".xml") for n in sources) else ())
    ]
    errors = sum(d.severity == "error" for d in found)
    if as_json:
        document = {
            "schema": "slabcell.krl-check/1",
            "files": len(sources),
            "errors": errors,
            "warnings": len(found) - errors,
            "diagnostics": [
                {
                    "file": d.file,
                    "line": d.line,
                    "column": d.column,
                    "severity": d.severity,
                    "code": d.code,
                    "controller_number": d.controller_number,
                    "message": d.message,
                }
                for d in found
            ],
        }
        typer.echo(json.dumps(document))
    else:
        for diagnostic in found:
            typer.echo(str(diagnostic))
        typer.echo(f"{len(sources)} files, {errors} errors, {len(found) - errors} warnings")
    if errors:
        raise typer.Exit(1)


def _read(paths: Iterable[Path]) -> dict[str, bytes]:
    """Return the KRL and XML files named, and those below the folders named, by the path that was given."""
    endings = {*ENDINGS, ".xml"}
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += [p for p in sorted(path.rglob("*")) if p.suffix.lower() in endings and p.is_file()]
        elif path.is_file():
            if path.suffix.lower() not in endings:
                msg = f"{path}: not a KRL file; .src, .dat, .sub and .xml are checked"
                raise UsageError(msg)
            found.append(path)
        else:
            msg = f"{path}: there is no such file or folder"
            raise UsageError(msg)
    if not found:
        msg = f"{', '.join(map(str, paths))}: no .src, .dat or .sub file there"
        raise UsageError(msg)
    sources: dict[str, bytes] = {}
    for path in found:
        if path.stat().st_size > MAX_FILE_BYTES:
            msg = f"{path}: {path.stat().st_size} bytes, at most {MAX_FILE_BYTES} are read"
            raise UsageError(msg)
        sources[path.as_posix()] = read_file(path)
    return sources
