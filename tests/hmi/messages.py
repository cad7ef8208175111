"""Which English messages of the daemon do pages show?  Read out of its source: doctor, alarms, what was done."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOM = Path(__file__).parents[2] / "daemon" / "slabcell"
ALARM_VERBS = frozenset({"come", "settle", "_clear"})


def messages() -> dict[str, str]:
    """Return every message with its places as {0}, {1}, ..., and in which file it stands."""
    found: dict[str, str] = {}
    for path in sorted(ROOM.glob("service/doctor*.py")):
        for text in _of_doctor(ast.parse(path.read_text())):
            found.setdefault(text, path.name)
    for path in sorted(ROOM.glob("**/resources/*.py")):
        for text in _of_done(ast.parse(path.read_text())):
            found.setdefault(text, path.name)
    for path in sorted([*ROOM.glob("cell/*.py"), *ROOM.glob("service/*.py")]):
        for text in _of_alarms(ast.parse(path.read_text())):
            found.setdefault(text, path.name)
    return {text: name for text, name in found.items() if text.strip("{}0")}


def _of_doctor(tree: ast.AST) -> Iterator[str]:
    """Yield the texts of answers (severity, found, remedy), those that have a name first included."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        named: dict[str, list[ast.expr]] = {}
        for node in ast.walk(function):
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                named.setdefault(node.targets[0].id, []).append(node.value)
        for node in ast.walk(function):
            if isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == 3:
                for part in node.value.elts[1:]:
                    for value in named.get(part.id, []) if isinstance(part, ast.Name) else [part]:
                        yield from _texts(value)


def _of_done(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Done":
            for keyword in node.keywords:
                if keyword.arg == "detail":
                    yield from _texts(keyword.value)


def _texts(value: ast.expr) -> Iterator[str]:
    """Yield the texts that an expression may be; what is not written there has no text."""
    if isinstance(value, ast.IfExp):
        yield from _texts(value.body)
        yield from _texts(value.orelse)
    elif isinstance(value, ast.Constant) and isinstance(value.value, str):
        yield value.value
    elif isinstance(value, ast.JoinedStr):
        places = iter(range(100))
        yield "".join(
            str(part.value) if isinstance(part, ast.Constant) else f"{{{next(places)}}}" for part in value.values
        )


def _of_alarms(tree: ast.AST) -> Iterator[str]:
    """Yield what is said where an alarm comes or goes, as far as it is written there."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in ALARM_VERBS:
            for value in node.args[1:2]:
                yield from _texts(value)
