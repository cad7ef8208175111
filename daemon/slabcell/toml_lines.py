"""On which line of a TOML file does each key stand?  The parser does not say, and people want to know.

The text is cut into statements, each as many lines as it takes until the parser accepts them, and each statement is
parsed by itself: so a line is found by the same rules by which the file was read.
"""

from __future__ import annotations

import tomllib
from typing import Any, cast

__all__ = ["KeyPath", "key_lines"]

MAX_STATEMENT_LINES = 500

KeyPath = tuple[str | int, ...]


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line, counted from 1, of every key of a text that is valid TOML; tables count by their header.

    Keys within a statement of several lines have its first line.
    """
    found: dict[KeyPath, int] = {}
    table: KeyPath = ()
    counts: dict[KeyPath, int] = {}
    lines = text.replace("\r\n", "\n").split("\n")  # str.splitlines ends lines where TOML does not
    at = 0
    while at < len(lines):
        statement, taken = _statement(lines, at)
        if lines[at].lstrip().startswith("["):
            table = _table(statement, counts)
            found.setdefault(table, at + 1)
        else:
            for path in _paths(statement):
                found.setdefault((*table, *path), at + 1)
        at += taken
    return found


def _statement(lines: list[str], at: int) -> tuple[dict[str, object], int]:
    """Return what the statement that begins at a line holds, and how many lines it takes."""
    for taken in range(1, min(MAX_STATEMENT_LINES, len(lines) - at) + 1):
        try:
            return tomllib.loads("\n".join(lines[at : at + taken])), taken
        except tomllib.TOMLDecodeError:
            continue
    return {}, 1


def _table(statement: dict[str, object], counts: dict[KeyPath, int]) -> KeyPath:
    """Return the path of a header; ``counts`` says how many there were of each array of tables."""
    path: list[str | int] = []
    here: Any = statement
    while isinstance(here, dict) and here:
        entries = cast("dict[str, Any]", here)
        name = next(iter(entries))
        path.append(name)
        here = entries[name]
        known = tuple(path)
        if isinstance(here, list):
            counts[known] = counts.get(known, -1) + 1
            return (*known, counts[known])
        if known in counts:  # a table within the last element of an array of tables
            path.append(counts[known])
    return tuple(path)


def _paths(value: object) -> list[KeyPath]:
    if isinstance(value, dict):
        entries = cast("dict[str, object]", value).items()
    elif isinstance(value, list) and any(isinstance(item, (dict, list)) for item in cast("list[object]", value)):
        entries = enumerate(cast("list[object]", value))
    else:
        return []
    paths: list[KeyPath] = []
    for name, inner in entries:
        paths.append((name,))
        paths += [(name, *rest) for rest in _paths(inner)]
    return paths
