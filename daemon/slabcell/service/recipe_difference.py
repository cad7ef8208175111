"""In what do two recipes differ?  Parameter by parameter, as they count in the cell, whatever their files say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, cast

from slabcell.cell.bundle import recipe_document
from slabcell.recipe import Recipe

__all__ = ["Change", "differences"]

_TABLES: Final = ("segmentation", "blobs", "matching", "grasp", "gates")


@dataclass(frozen=True, slots=True)
class Change:
    """One parameter: its key as in a recipe's file, and its two values as JSON."""

    key: str
    before: Any
    after: Any


def differences(before: Recipe, after: Recipe) -> list[Change]:
    """Return the parameters that differ, in the order of the file; templates are not compared."""
    old, new = dict(_parameters(before)), dict(_parameters(after))
    keys = [*old, *(key for key in new if key not in old)]
    return [Change(key, old.get(key), new.get(key)) for key in keys if old.get(key) != new.get(key)]


def _parameters(recipe: Recipe) -> Iterator[tuple[str, Any]]:
    yield "template.thickness_mm", recipe.thickness_mm
    yield "template.other_thickness", {str(slot): value for slot, value in sorted(recipe.other_thickness_mm.items())}
    document = recipe_document(recipe)
    for table in _TABLES:
        yield from _flat(table, cast("Mapping[str, Any]", document[table]))


def _flat(above: str, table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{above}.{name}", cast("Mapping[str, Any]", value))
        else:
            yield f"{above}.{name}", value
