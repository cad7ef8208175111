"""Which recipe is active?  The one that was activated last, else that of the configuration.

Recipes lie beside the one that the configuration names, where people put them.  Versions that were saved over the
control API lie in the state directory, as NAME~1, NAME~2, ...: nothing is ever overwritten.  The choice is a file of
the state directory, so that it survives a restart; one that names a recipe that is gone is an error, and never a silent
return to another.
"""

from __future__ import annotations

import json
import re
import threading
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

from slabcell.catalogue import Fault
from slabcell.errors import RecipeError, SlabcellError
from slabcell.recipe import load_recipe
from slabcell.service.atomic import write_atomically
from slabcell.service.candidate import Candidate
from slabcell.service.choice import read_choice
from slabcell.service.recipe_text import to_toml

__all__ = ["RecipeEntry", "RecipeShelf", "version_of"]

SCHEMA: Final = "slabcell.active-recipe/1"
MAX_RECIPES: Final = 500
NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,59}")


@dataclass(frozen=True, slots=True)
class RecipeEntry:
    """One recipe file; ``problem`` says what is wrong with it, empty if nothing is.

    ``root`` is the recipe that it is a version of: itself, ``version`` 0, unless it was saved over the control API.
    """

    name: str
    root: str
    version: int
    sha256: str
    slots: int
    template_sha256: str
    problem: str


class RecipeShelf:
    """The recipes of one cell.  Methods block: run them in a thread."""

    def __init__(self, configured: Path, state: Path) -> None:
        self._configured = configured
        self._saved = state / "recipes"
        self._choice = state / "active-recipe.json"
        self._lock = threading.Lock()

    @property
    def active(self) -> Path:
        """The file of the active recipe.  Raises RecipeError if the choice cannot be read, or is gone."""
        try:
            name = read_choice(self._choice, SCHEMA, "recipe")
        except OSError as error:
            msg = f"{self._choice}: cannot be read: {error.strerror}"
            raise RecipeError(msg, number=Fault.RECIPE_MISSING) from error
        if name is None:
            return self._configured
        path = self._find(name)
        if path is None:
            said = f"names recipe {name!r:.60}, which is not there" if name else "is damaged"
            msg = f"{self._choice}: {said}; delete this file to go by the configuration, or restore the recipe"
            raise RecipeError(msg, number=Fault.RECIPE_MISSING)
        return path

    def entries(self) -> list[RecipeEntry]:
        """Return every recipe: those of the configuration by name, then saved versions."""
        return [self._entry(path) for path in self._paths()[:MAX_RECIPES]]

    def _paths(self) -> list[Path]:
        saved = sorted(self._saved.glob("*.toml"), key=lambda path: version_of(path.stem))
        return [*sorted(self._configured.parent.glob("*.toml")), *saved]

    def _entry(self, path: Path) -> RecipeEntry:
        root, version = version_of(path.stem)
        digest = sha256(path.read_bytes()).hexdigest()
        try:
            recipe = load_recipe(path)
        except SlabcellError as error:
            return RecipeEntry(path.stem, root, version, digest, 0, "", str(error))
        return RecipeEntry(path.stem, root, version, digest, len(recipe.template.slots), recipe.template.sha256, "")

    def path_of(self, name: str) -> Path:
        """Return the file of a recipe by its name.  Raises RecipeError."""
        path = self._find(name)
        if path is None:
            msg = f"there is no recipe {name!r:.60} in {self._configured.parent} or {self._saved}"
            raise RecipeError(msg, number=Fault.RECIPE_MISSING)
        return path

    def _find(self, name: str) -> Path | None:
        if not name or Path(name).name != name:
            return None
        candidates = (folder / f"{name}.toml" for folder in (self._configured.parent, self._saved))
        return next((path for path in candidates if path.is_file()), None)

    def graded(self, name: str) -> tuple[Path, Path]:
        """Return the folders of a recipe's graded set, which its versions share; pictures are added to the last."""
        root, _ = version_of(name)
        return self._configured.parent / f"{root}.graded", self._saved / f"{root}.graded"

    def save(self, base: str, candidate: Candidate, name: str | None = None) -> str:
        """Write a candidate as a new version of the recipe that it is based on, or as a new recipe; return its name.

        Raises RecipeError.
        """
        if name is not None and not NAME.fullmatch(name):
            msg = f"{name!r:.80} is no name of a recipe: 1 to 60 of A-Z a-z 0-9 . _ -, the first a letter or digit"
            raise RecipeError(msg)
        root, _ = version_of(base)
        with self._lock:
            paths = self._paths()
            if len(paths) >= MAX_RECIPES:
                msg = f"there are {len(paths)} recipes, the limit is {MAX_RECIPES}: delete some from {self._saved}"
                raise RecipeError(msg)
            remark = f"Recipe {name}, based on {base}, saved over the control API."
            if name is None:
                version = 1 + max(
                    number for known, number in map(version_of, [root, *(p.stem for p in paths)]) if known == root
                )
                name = f"{root}~{version}"
                remark = f"Version {version} of {root}, based on {base}, saved over the control API."
            elif any(path.stem.casefold() == name.casefold() for path in paths):
                msg = f"there is a recipe {name} already: choose another name, or save a version of it"
                raise RecipeError(msg)
            reference = candidate.written.template.model_copy(update={"file": f"{name}.csv"})
            written = candidate.written.model_copy(update={"template": reference})
            text = to_toml(written, remark=remark)
            try:
                self._saved.mkdir(exist_ok=True)
                write_atomically(self._saved / f"{name}.csv", candidate.template_csv)
                write_atomically(self._saved / f"{name}.toml", text.encode())
            except OSError as error:
                msg = f"{self._saved / name}: cannot be written: {error.strerror}"
                raise RecipeError(msg, number=Fault.STATE_UNWRITABLE) from error
        return name

    def choose(self, name: str) -> None:
        """Have a recipe be the active one from the next start on.  Raises RecipeError."""
        content = json.dumps({"schema": SCHEMA, "recipe": name}).encode()
        try:
            write_atomically(self._choice, content)
        except OSError as error:
            msg = f"{self._choice}: cannot be written: {error.strerror}"
            raise RecipeError(msg, number=Fault.STATE_UNWRITABLE) from error


def version_of(name: str) -> tuple[str, int]:
    """Return the recipe that a name is a version of, and which; 0 for what was not saved over the control API."""
    root, mark, number = name.rpartition("~")
    if mark and root and number.isascii() and number.isdecimal() and len(number) < 10:
        return root, int(number)
    return name, 0
