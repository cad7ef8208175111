"""`slabcell replay`: do recorded cycles give the same poses today?"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from slabcell import __version__
from slabcell.cell.bundle_file import read_bundle
from slabcell.cell.replay import NothingToReplayError, Replay, replay
from slabcell.cli.talk import make_console
from slabcell.errors import SlabcellError
from slabcell.recipe import Recipe, load_recipe

__all__ = ["replay_command"]


def replay_command(
    bundles: Annotated[
        list[Path], typer.Argument(metavar="BUNDLE...", help="Bundles of cycles, as the cell keeps them.")
    ],
    recipe: Annotated[
        Path | None, typer.Option("--recipe", help="Use this recipe instead of the recorded one.")
    ] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object for each bundle.")] = False,
) -> None:
    """Run recorded cycles again and compare the poses.

    With the same version and recipe every digit must be the same.  Exit code 1 if anything differs, a bundle cannot be
    run, or none was: those of verifications, in which nothing was offered, are passed over.
    """
    other = load_recipe(recipe) if recipe is not None else None
    console = make_console()
    failed, compared = False, 0
    for path in bundles:
        try:
            failed |= not _one(path, other, console, as_json=as_json)
            compared += 1
        except NothingToReplayError as error:
            _tell(path, error, console, "·", as_json=as_json)
        except SlabcellError as error:  # the other bundles are still worth a look
            failed = True
            _tell(path, error, console, "✗", style="bold red", as_json=as_json)
    if failed or not compared:
        raise typer.Exit(1)


def _tell(
    path: Path, error: SlabcellError, console: Console, mark: str, *, style: str | None = None, as_json: bool
) -> None:
    if as_json:
        typer.echo(json.dumps({"schema": "slabcell.replay/1", "bundle": str(path), "error": str(error)}))
    else:
        console.print(f"{mark} {error}", style=style, highlight=False)


def _one(path: Path, other: Recipe | None, console: Console, *, as_json: bool) -> bool:
    bundle = read_bundle(path)
    outcome = replay(bundle, other)
    if as_json:
        document = {
            "schema": "slabcell.replay/1",
            "bundle": str(path),
            "recorded_with": bundle.version,
            "replayed_with": __version__,
            "recipe": other.name if other else bundle.recipe.name,
            "same": outcome.same,
            "same_order": outcome.same_order,
            "pairs": len(outcome.pairs),
            "differences": [asdict(item) for item in outcome.differences],
        }
        typer.echo(json.dumps(document))
    else:
        _print(path, bundle.version, outcome, console)
    return outcome.same


def _print(path: Path, version: str, outcome: Replay, console: Console) -> None:
    versions = f"recorded with {version}, replayed with {__version__}"
    if outcome.same:
        console.print(f"✓ {path}: {len(outcome.pairs)} pairs, every digit the same ({versions})", highlight=False)
        return
    console.print(f"✗ {path}: {versions}", style="bold red", highlight=False)
    if not outcome.same_order:
        console.print("  the slots are laid in another order", highlight=False)
    if outcome.differences:
        table = Table("slot", "pick mm", "place mm", "turn °", "what")
        for item in outcome.differences:
            numbers = (item.pick_mm, item.place_mm, item.turn_deg)
            table.add_row(str(item.slot), *("" if value is None else f"{value:.4f}" for value in numbers), item.what)
        console.print(table)
