"""`slabcell recipe`: verify a recipe against pictures that a person has graded, and make it the active one."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from slabcell.cli.recipe_cell import activate_running, add_running_verbs, path_of, verify_running
from slabcell.cli.talk import Socket, client
from slabcell.errors import UsageError
from slabcell.service.recipes import ACTIVATION_S, DEFAULT_DEG, DEFAULT_MM, Verification, activate, add_graded, verify

__all__ = ["recipe_app"]

recipe_app = typer.Typer(no_args_is_help=True)
add_running_verbs(recipe_app)

FileOrName = Annotated[
    Path, typer.Argument(metavar="RECIPE", help="The recipe's file, or the name of a recipe of the running cell.")
]
Millimetres = Annotated[float, typer.Option("--mm", min=0.0, help="How far a pose may be off.")]
Degrees = Annotated[float, typer.Option("--deg", min=0.0, help="How far an angle may be off.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@recipe_app.command("grade")
def grade_command(
    recipe: FileOrName,
    bundles: Annotated[
        list[Path] | None, typer.Argument(metavar="[BUNDLE...]", help="Cycles that you have found right.")
    ] = None,
    cycles: Annotated[
        list[int] | None, typer.Option("--cycle", metavar="NUMBER", help="Or their numbers on the running cell.")
    ] = None,
    socket: Socket = None,
) -> None:
    """Add cycles that a person has looked at and found right to the recipe's graded set.

    Cycles that are named by number are kept by the running cell, for its recipe of that name.
    """
    if bool(bundles) == bool(cycles):
        msg = "name bundles to add, or cycles of the running cell with --cycle"
        raise UsageError(msg)
    for path in add_graded(recipe, bundles or []) if bundles else ():
        typer.echo(str(path))
    for number in cycles or ():
        typer.echo(client(socket).post(path_of(str(recipe), "grade"), {"cycle": number})["detail"])


@recipe_app.command("verify")
def verify_command(
    recipe: FileOrName,
    mm: Millimetres = DEFAULT_MM,
    deg: Degrees = DEFAULT_DEG,
    socket: Socket = None,
    *,
    as_json: Json = False,
) -> None:
    """Run the recipe on its graded set.  Exit code 1 if a picture comes out otherwise.

    What is no file is the name of a recipe of the running cell, which then does the work, with its own tolerances.
    """
    if recipe.is_file():
        done = verify(recipe, tolerance_mm=mm, tolerance_deg=deg)
    else:
        done = Verification.from_document(verify_running(client(socket), str(recipe)))
    _tell(done, as_json=as_json)
    if not done.passed:
        raise typer.Exit(1)


@recipe_app.command("activate")
def activate_command(
    recipe: FileOrName,
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The cell's configuration.")] = Path(
        "/etc/slabcell/cell.toml"
    ),
    socket: Socket = None,
    mm: Millimetres = DEFAULT_MM,
    deg: Degrees = DEFAULT_DEG,
    *,
    as_json: Json = False,
) -> None:
    """Verify the recipe, then make it the one that the cell works with.

    Refused with exit code 78 if it does not pass its graded set, and with 75 while a job is open.  What is no file
    is the name of a recipe of the running cell, which verifies it itself.
    """
    if not recipe.is_file():
        detail = activate_running(client(socket, timeout_s=ACTIVATION_S), str(recipe))
        typer.echo(json.dumps({"schema": "slabcell.recipe-activation/1", "activated": detail}) if as_json else detail)
        return
    done = verify(recipe, tolerance_mm=mm, tolerance_deg=deg)
    _tell(done, as_json=as_json, activated=activate(recipe, config, done, socket=socket))


def _tell(done: Verification, *, as_json: bool, activated: str = "") -> None:
    if as_json:
        document = {"schema": "slabcell.recipe-verification/1", **asdict(done), "passed": done.passed}
        typer.echo(json.dumps({**document, "activated": activated or None}))
        return
    for item in done.pictures:
        typer.echo(f"{'✗' if item.problems else '✓'} {item.bundle}")
        for problem in item.problems:
            typer.echo(f"    {problem}")
    if not done.pictures:
        typer.echo("no graded set: `slabcell recipe grade` makes one of bundles")
    typer.echo(f"{done.recipe}: {'passed' if done.passed else 'not passed'}, sha256 {done.sha256}")
    if activated:
        typer.echo(activated)
