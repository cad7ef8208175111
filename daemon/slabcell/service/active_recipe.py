"""Which recipe is active?  The one that was activated last, else that of the configuration.

Recipes lie beside the one that the configuration names.  The choice is a file of the state directory, so that it
survives a restart; one that names a recipe that is gone is an error, and never a silent return to another.
"""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final, cast

from slabcell.catalogue import Fault
from slabcell.errors import RecipeError, SlabcellError
from slabcell.recipe import load_recipe

__all__ = ["RecipeEntry", "RecipeShelf"]

SCHEMA: Final = "slabcell.active-recipe/1"
MAX_BYTES: Final = 64 << 10
MAX_RECIPES: Final = 500


@dataclass(frozen=True, slots=True)
class RecipeEntry:
    """One recipe file; ``problem`` says what is wrong with it, empty if nothing is."""

    name: str
    sha256: str
    slots: int
    template_sha256: str
    problem: str


class RecipeShelf:
    """The recipes of one cell.  Methods block: run them in a thread."""

    def __init__(self, configured: Path, state: Path) -> None:
        self._configured = configured
        self._choice = state / "active-recipe.json"

    @property
    def active(self) -> Path:
        """The file of the active recipe.  Raises RecipeError if the choice cannot be read, or is gone."""
        try:
            with self._choice.open("rb") as stream:
                raw = stream.read(MAX_BYTES)
        except FileNotFoundError:
            return self._configured
        except OSError as error:
            msg = f"{self._choice}: cannot be read: {error.strerror}"
            raise RecipeError(msg, number=Fault.RECIPE_MISSING) from error
        try:
            document = cast("dict[str, object]", json.loads(raw))
            name = str(document["recipe"]) if document["schema"] == SCHEMA else ""
        except (ValueError, KeyError, TypeError):  # damaged: said below, by the file's name
            name = ""
        path = self._configured.parent / f"{name}.toml"
        if not name or Path(name).name != name or not path.is_file():
            said = f"names recipe {name!r:.60}, which is not there" if name else "is damaged"
            msg = f"{self._choice}: {said}; delete this file to go by the configuration, or restore the recipe"
            raise RecipeError(msg, number=Fault.RECIPE_MISSING)
        return path

    def entries(self) -> list[RecipeEntry]:
        """Return every recipe, in the order of their names."""
        return [self._entry(path) for path in sorted(self._configured.parent.glob("*.toml"))[:MAX_RECIPES]]

    def _entry(self, path: Path) -> RecipeEntry:
        digest = sha256(path.read_bytes()).hexdigest()
        try:
            recipe = load_recipe(path)
        except SlabcellError as error:
            return RecipeEntry(path.stem, digest, 0, "", str(error))
        return RecipeEntry(path.stem, digest, len(recipe.template.slots), recipe.template.sha256, "")

    def path_of(self, name: str) -> Path:
        """Return the file of a recipe by its name.  Raises RecipeError."""
        path = self._configured.parent / f"{name}.toml"
        if Path(name).name != name or not path.is_file():
            msg = f"there is no recipe {name!r:.60} in {self._configured.parent}"
            raise RecipeError(msg, number=Fault.RECIPE_MISSING)
        return path

    def choose(self, name: str) -> None:
        """Have a recipe be the active one from the next start on.  Raises RecipeError."""
        try:
            handle, temporary = tempfile.mkstemp(prefix=".active-recipe.", dir=self._choice.parent)
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                json.dump({"schema": SCHEMA, "recipe": name}, stream)
                stream.flush()
                os.fsync(stream.fileno())
            Path(temporary).replace(self._choice)
        except OSError as error:
            msg = f"{self._choice}: cannot be written: {error.strerror}"
            raise RecipeError(msg, number=Fault.STATE_UNWRITABLE) from error
