"""May this recipe become the active one?  It has to find again, in pictures that a person has graded, what they show.

The graded set of ``NAME.toml`` is the folder ``NAME.graded`` beside it: bundles of cycles that a person has looked at
and found right.  Each is run again with the recipe, and every slab has to come out in the same slot within the
tolerances.  The active recipe is a drop-in of the configuration, with the sum of what was verified; it changes only
between jobs.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from slabcell.cell.bundle_file import read_bundle
from slabcell.cell.replay import replay
from slabcell.errors import RecipeError, SlabcellError, TemporaryError, UnavailableError
from slabcell.recipe import load_recipe
from slabcell.service.api.client import ApiClient

__all__ = ["Graded", "Verification", "activate", "add_graded", "recipe_sha256", "verify"]

DROP_IN = "50-recipe.toml"
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

    @property
    def passed(self) -> bool:
        """Whether every picture came out as it was graded."""
        return not any(item.problems for item in self.pictures)


def recipe_sha256(path: Path) -> str:
    """Return the sum over a recipe's file, its template and the names and contents of its graded set: its version."""
    total = hashlib.sha256(path.read_bytes())
    total.update(load_recipe(path).template.sha256.encode("ascii"))
    for bundle in _set(path):
        total.update(bundle.name.encode() + hashlib.sha256(bundle.read_bytes()).digest())
    return total.hexdigest()


def verify(path: Path, *, tolerance_mm: float = DEFAULT_MM, tolerance_deg: float = DEFAULT_DEG) -> Verification:
    """Run the graded set of a recipe.  Raises RecipeError, TemplateError or BundleError for files that are damaged."""
    recipe = load_recipe(path)
    pictures: list[Graded] = []
    for file in _set(path):
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
    return Verification(recipe.name, recipe_sha256(path), tuple(pictures))


def add_graded(path: Path, bundles: list[Path]) -> list[Path]:
    """Copy bundles that a person has found right into a recipe's set; return where they lie.

    Raises RecipeError for one whose template is another, and BundleError for one that is none.
    """
    recipe = load_recipe(path)
    for file in bundles:
        theirs = read_bundle(file).recipe.template
        if theirs.sha256 != recipe.template.sha256:
            msg = f"{file}: is of template {theirs.name}, {theirs.sha256[:12]}; the recipe's is {recipe.template.name}"
            raise RecipeError(msg)
    folder = _folder(path)
    folder.mkdir(exist_ok=True)
    return [Path(shutil.copy2(file, folder / file.name)) for file in bundles]


def activate(path: Path, config: Path, done: Verification, *, socket: Path | None = None) -> Path:
    """Make a verified recipe the one that the cell works with from its next start on; return the drop-in written.

    Raises RecipeError if the set was not passed or the recipe has changed since, and TemporaryError while a job is
    open.
    """
    if not done.passed:
        failed = ", ".join(item.bundle for item in done.pictures if item.problems)
        msg = f"{path}: does not pass its graded set ({failed}); correct the recipe, or the set if it is wrong"
        raise RecipeError(msg)
    if recipe_sha256(path) != done.sha256:
        msg = f"{path}: has changed since it was verified; verify it again"
        raise RecipeError(msg)
    job = _open_job(socket)
    if job is not None:
        msg = f"job {job} is open: a recipe changes only between jobs; finish or abandon it first"
        raise TemporaryError(msg)
    target = config.with_name(f"{config.name}.d") / DROP_IN
    now = datetime.now(UTC).isoformat(timespec="seconds")
    text = (
        "# Written by `slabcell recipe activate`: the recipe that the cell works with.\n"
        f"# verified {now}, {len(done.pictures)} graded pictures, sha256 {done.sha256}\n"
        f"recipe = {json.dumps(str(path.resolve()))}\n"
    )
    try:
        target.parent.mkdir(exist_ok=True)
        temporary = target.with_suffix(".part")
        with temporary.open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(target)
    except OSError as error:
        msg = f"{target}: cannot be written: {error.strerror}; the active recipe is as before"
        raise SlabcellError(msg) from error
    return target


def _open_job(socket: Path | None) -> int | None:
    """Return the job that is open in the running cell; None if none is, or no cell runs."""
    try:
        job = ApiClient(socket, timeout_s=5.0).get("/v1/status")["job"]
    except UnavailableError:
        return None
    return int(job["job_id"]) if job is not None and job["state"] == "open" else None


def _folder(path: Path) -> Path:
    return path.with_suffix(".graded")


def _set(path: Path) -> list[Path]:
    return sorted(_folder(path).glob("*.zip"))
