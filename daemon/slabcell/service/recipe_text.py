"""How is a recipe written down?  TOML with every value said, so that it stays what it was when defaults change."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import cast

from slabcell.recipe import RecipeFile

__all__ = ["to_toml"]


def to_toml(written: RecipeFile, *, remark: str = "") -> str:
    """Return the text of a recipe file; ``remark`` stands above it, as comments."""
    lines = [f"# {line}" for line in remark.splitlines()]
    lines += [""] if lines else []
    lines += _table(written.model_dump(mode="json", exclude_none=True), ())
    return "\n".join(lines).strip() + "\n"


def _table(content: Mapping[str, object], path: tuple[str, ...]) -> Iterator[str]:
    tables: list[tuple[str, object]] = []
    values: list[str] = []
    for key, value in content.items():
        if isinstance(value, dict) or _is_tables(value):
            tables.append((key, cast("object", value)))
        else:
            values.append(f"{key} = {_value(value)}")
    if path and values:
        yield f"[{'.'.join(path)}]"
    yield from values
    if values:
        yield ""
    for key, value in tables:
        if isinstance(value, dict):
            yield from _table(cast("Mapping[str, object]", value), (*path, key))
            continue
        for item in cast("list[Mapping[str, object]]", value):
            yield f"[[{'.'.join((*path, key))}]]"
            yield from (f"{name} = {_value(inner)}" for name, inner in item.items())
            yield ""


def _is_tables(value: object) -> bool:
    """Return whether it is an array of tables.  In recipes these hold no tables again."""
    return isinstance(value, list) and isinstance(next(iter(cast("list[object]", value)), None), dict)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return f"[{', '.join(map(_value, cast('list[object]', value)))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)  # a JSON string, with its escapes, is a TOML basic string
    return repr(value)
