"""May this recipe become the active one?  It has to find again, in pictures that a person has graded, what they show.

The graded set of ``NAME.toml`` is the folder ``NAME.graded`` beside it: bundles of cycles that a person has looked at
and found right.  Each is run again with the recipe, and every slab has to come out in the same slot within the
tolerances.  The choice is the state directory's (`active_recipe`); it changes only between jobs.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

from slabcell.cell.bundle_file import read_bundle
from slabcell.cell.replay import replay
from slabcell.errors import RecipeError, UnavailableError
from slabcell.recipe import load_recipe
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.client import ApiClient
from slabcell.service.config_layers import load_config
from slabcell.service.devices import state_directory

__all__ = ["ACTIVATION_S", "Graded", "Verification", "activate", "add_graded", "recipe_sha256", "verify"]

# A daemon runs the graded set once more before it changes.
ACTIVATION_S = 120.0
DEFAULT_MM, DEFAULT_DEG = 0.2, 0.2


@dataclass(frozen=True, slots=True)
class Graded:
    """One picture of the set: what came out otherwise than it was graded; nothing if it passed."""

    bundle: str
    problems: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Verification:
    """What came of a recipe's graded set; a recipe without a set has nothing to fail."""

    recipe: str
    sha256: str
    pictures: tuple[Graded, ...]

    @classmethod
    def from_document(cls, said: Mapping[str, Any]) -> Self:
        """Return what the bench said of a recipe."""
        pictures = tuple(Graded(str(item["bundle"]), tuple(map(str, item["problems"]))) for item in said["pictures"])
        return cls(str(said["recipe"]), str(said["sha256"]), pictures)

    @property
    def passed(self) -> bool:
        """Whether every picture came out as it was graded."""
        return not any(item.problems for item in self.pictures)

    def require(self) -> None:
        """Raise RecipeError unless every picture came out as it was graded."""
        if not self.passed:
            failed = ", ".join(item.bundle for item in self.pictures if item.problems)
            msg = f"recipe {self.recipe} does not pass its graded set ({failed}): correct it, or the set if it is wrong"
            raise RecipeError(msg)


def recipe_sha256(path: Path, graded: Sequence[Path] | None = None) -> str:
    """Return the sum over a recipe's file, its template and the names and contents of its graded set: its version."""
    total = hashlib.sha256(path.read_bytes())
    total.update(load_recipe(path).template.sha256.encode("ascii"))
    for bundle in _set(path, graded):
        total.update(bundle.name.encode() + hashlib.sha256(bundle.read_bytes()).digest())
    return total.hexdigest()


def verify(
    path: Path,
    *,
    tolerance_mm: float = DEFAULT_MM,
    tolerance_deg: float = DEFAULT_DEG,
    graded: Sequence[Path] | None = None,
    done: Callable[[int, int, str], None] | None = None,
) -> Verification:
    """Run the graded set of a recipe: the folder beside it, or those that are named.

    ``done`` is told before each picture how many are done, of how many, and its name.  Raises RecipeError,
    TemplateError or BundleError for files that are damaged.
    """
    recipe = load_recipe(path)
    pictures: list[Graded] = []
    files = _set(path, graded)
    for number, file in enumerate(files):
        if done is not None:
            done(number, len(files), file.name)
        outcome = replay(read_bundle(file), recipe)
        problems: list[str] = []
        for item in outcome.differences:
            moved = (item.pick_mm, item.place_mm, item.turn_deg)
            if item.pick_mm is None or item.place_mm is None or item.turn_deg is None:
                problems.append(f"slot {item.slot}: {item.what}")
            elif max(item.pick_mm, item.place_mm) > tolerance_mm or item.turn_deg > tolerance_deg:
                pick, place, turn = (f"{value:.3f}" for value in moved if value is not None)
                problems.append(f"slot {item.slot}: pick {pick} mm, place {place} mm, {turn}° off")
        pictures.append(Graded(file.name, tuple(problems)))
    return Verification(recipe.name, recipe_sha256(path, graded), tuple(pictures))


def add_graded(path: Path, bundles: list[Path], *, folder: Path | None = None) -> list[Path]:
    """Copy bundles that a person has found right into a recipe's set, ``folder`` if it is named; return where they lie.

    Raises RecipeError for one whose template is another, and BundleError for one that is none.
    """
    recipe = load_recipe(path)
    for file in bundles:
        theirs = read_bundle(file).recipe.template
        if theirs.sha256 != recipe.template.sha256:
            msg = f"{file}: is of template {theirs.name}, {theirs.sha256[:12]}; the recipe's is {recipe.template.name}"
            raise RecipeError(msg)
    folder = folder or _folder(path)
    folder.mkdir(parents=True, exist_ok=True)
    return [Path(shutil.copy2(file, folder / file.name)) for file in bundles]


def activate(path: Path, config: Path, done: Verification, *, socket: Path | None = None) -> str:
    """Make a verified recipe the one that the cell works with, also after a restart; return what was done.

    A running daemon is asked, which changes between jobs only; else the choice is written where it will look for it.
    Raises RecipeError if the set was not passed, the recipe has changed since or lies elsewhere than the recipe of the
    configuration, and TemporaryError while a job is open.
    """
    done.require()
    if recipe_sha256(path) != done.sha256:
        msg = f"{path}: has changed since it was verified; verify it again"
        raise RecipeError(msg)
    settings = load_config(config)
    if path.resolve().parent != settings.recipe.resolve().parent:
        msg = f"{path}: the cell's recipes lie in {settings.recipe.parent}: copy it there with its template and set"
        raise RecipeError(msg)
    client = ApiClient(socket, timeout_s=ACTIVATION_S)
    try:
        return str(client.post(f"/v1/recipes/{quote(path.stem, safe='')}/activate")["detail"])
    except UnavailableError:  # no daemon runs: it will find the choice when it starts
        RecipeShelf(settings.recipe, state_directory(settings.state_directory)).choose(path.stem)
        return f"recipe {path.stem} is active from the next start on"


def _folder(path: Path) -> Path:
    return path.with_suffix(".graded")


def _set(path: Path, graded: Sequence[Path] | None) -> list[Path]:
    folders = (_folder(path),) if graded is None else graded
    return sorted((file for folder in folders for file in folder.glob("*.zip")), key=lambda file: file.name)
