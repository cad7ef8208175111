"""Which form has a recipe?  Made from the JSON schema of recipes, with units, ranges and help, in a person's language.

The schema comes from the daemon, so that a form fits the recipes of the daemon that it asks.  In English the words are
those of the schema; other languages have a table beside this file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal, cast

from slabcell.hmi.messages import load_words

__all__ = ["TABLES", "Field", "field_words", "form_document", "form_fields", "keys_of", "option_words"]

TABLES: Final = ("template", "gates", "segmentation", "blobs", "matching", "grasp")
LEFT_OUT: Final = frozenset({"template.file"})
"""What a form does not change: the template has a page of its own."""
UNIT_ENDINGS: Final = ("_mm2", "_mm4", "_mm", "_px", "_percent", "_deg", "_seconds", "_s")
ROOM: Final = Path(__file__).parent

Json = dict[str, Any]
Kind = Literal["number", "integer", "choice", "flag", "text", "numbers", "points", "table", "tables"]


@dataclass(frozen=True, slots=True)
class Field:
    """One parameter.

    ``minimum`` and ``maximum`` bound a number; ``above`` says that the minimum itself is not allowed.  ``least`` and
    ``most`` bound the entries of a list.  ``fields`` are those of a table, or of each table of a list.
    """

    key: str
    name: str
    label: str
    help: str
    kind: Kind
    unit: str
    optional: bool
    minimum: float | None
    maximum: float | None
    above: bool
    choices: tuple[str, ...]
    least: int
    most: int | None
    default: Any
    fields: tuple[Field, ...]


@cache
def field_words(language: str) -> Mapping[str, Mapping[str, str]]:
    """Return ``label`` and ``help`` of parameters by their key; few in English, which the schema speaks itself.

    Under ``options`` is what their choices are called.
    """
    path = ROOM / f"parameters.{language}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def option_words(fields: Iterable[Field], language: str) -> dict[str, str]:
    """Return what the choices of fields are called, the name that recipes have for each behind it; none in English."""
    known = {**load_words(language), **field_words(language).get("options", {})}
    names = {name for field in fields for name in (*field.choices, *option_words(field.fields, language))}
    return {name: f"{known[name]} ({name})" for name in sorted(names) if name in known}


def form_document(schema: Json, language: str) -> list[Json]:
    """Return the fields of every table, as JSON: ``[{"table": ..., "fields": [...]}]``."""
    return [
        {"table": table, "fields": [asdict(item) for item in form_fields(schema, table, language)]} for table in TABLES
    ]


def form_fields(schema: Json, table: str, language: str) -> tuple[Field, ...]:
    """Return the fields of one table of a recipe."""
    return _fields(schema, _resolved(schema, schema["properties"][table]), table, language)


def keys_of(fields: tuple[Field, ...]) -> Iterator[str]:
    """Return the key of every field, of those inside of tables too."""
    for field in fields:
        yield field.key
        yield from keys_of(field.fields)


def _fields(schema: Json, table: Json, above: str, language: str) -> tuple[Field, ...]:
    named = cast("dict[str, Json]", table["properties"])
    return tuple(
        _field(schema, name, said, f"{above}.{name}", language)
        for name, said in named.items()
        if f"{above}.{name}" not in LEFT_OUT
    )


def _field(schema: Json, name: str, said: Json, key: str, language: str) -> Field:
    options = [_resolved(schema, option) for option in said.get("anyOf", [said])]
    optional = any(option.get("type") == "null" for option in options)
    content = next(option for option in options if option.get("type") != "null")
    kind, inner = _kind(schema, content)
    above = "exclusiveMinimum" in content
    words = field_words(language).get(key, {})
    unit = str(said.get("x-unit", ""))
    return Field(
        key,
        name,
        words.get("label", _label(name)),
        words.get("help", str(said.get("description", ""))),
        kind,
        unit,
        optional,
        content.get("exclusiveMinimum", content.get("minimum")),
        content.get("maximum"),
        above,
        tuple(str(word) for word in content.get("enum", ())),
        int(content.get("minItems", 0)),
        content.get("maxItems"),
        said.get("default"),
        _fields(schema, inner, key, language) if inner else (),
    )


def _kind(schema: Json, content: Json) -> tuple[Kind, Json | None]:
    """Return what kind of field takes such a value, and the schema of the table that it is, or has."""
    match content.get("type"):
        case "boolean":
            return "flag", None
        case "integer":
            return "integer", None
        case "number":
            return "number", None
        case "object":
            return "table", content
        case "array":
            item = _resolved(schema, content["items"])
            if item.get("type") == "object":
                return "tables", item
            return ("points" if "prefixItems" in item else "numbers"), None
        case _:
            return ("choice" if "enum" in content else "text"), None


def _resolved(schema: Json, said: Json) -> Json:
    """Return what a reference means."""
    if "$ref" not in said:
        return said
    found: Json = schema["$defs"][str(said["$ref"]).rpartition("/")[2]]
    return found


def _label(name: str) -> str:
    """Return a name as people read it; its unit stands elsewhere."""
    bare = next((name.removesuffix(ending) for ending in UNIT_ENDINGS if name.endswith(ending)), name)
    return (bare or name).replace("_", " ").capitalize()
