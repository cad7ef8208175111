"""What may stand in a recipe?  The JSON schema of recipe files, with the unit of each number, for forms and editors."""

from __future__ import annotations

from typing import Any, Final, cast

from slabcell.recipe import RecipeFile

__all__ = ["recipe_schema", "unit_of"]

# The longest ending that fits counts.
_UNITS: Final = {"_mm2": "mm²", "_mm4": "mm⁴", "_mm": "mm", "_px": "px", "_percent": "%", "_deg": "°", "_seconds": "s"}

Json = dict[str, Any]


def recipe_schema() -> Json:
    """Return the schema: types, ranges, defaults and descriptions, and ``x-unit`` where a name ends with a unit."""
    schema: Json = RecipeFile.model_json_schema()
    for table in (schema, *cast("dict[str, Json]", schema["$defs"]).values()):
        for name, field in cast("dict[str, Json]", table.get("properties", {})).items():
            unit = unit_of(name)
            if unit:
                field["x-unit"] = unit
    return schema


def unit_of(name: str) -> str:
    """Return the unit that the name of a parameter says; empty for none."""
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")
