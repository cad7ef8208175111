"""Which English texts may a page show?  Every sentence in the source of the rooms that speak to people.

A text of several words in these rooms is one, unless it stands where nobody but the log, the database or the reader of
the API's description sees it.  So a new sentence is wanted in German without anybody having to think of it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
ROOMS: Final = (
    *("daemon/slabcell/calibration/**/*.py", "daemon/slabcell/vision/**/*.py", "daemon/slabcell/template/*.py"),
    *("daemon/slabcell/cell/*.py", "daemon/slabcell/service/**/*.py"),
    *("daemon/slabcell/recipe.py", "daemon/slabcell/toml_file.py", "daemon/slabcell/images.py"),
    *("daemon/slabcell/hmi/cell_api.py", "daemon/slabcell/hmi/link.py", "daemon/slabcell/hmi/security/store.py"),
    *("daemon/slabcell/hmi/pages/account/*.py", "daemon/slabcell/hmi/pages/tune/recipes.py"),
    *("drivers/slabcell_drivers/camera/*.py", "drivers/slabcell_drivers/light/*.py"),
    *("drivers/slabcell_drivers/robot/arm.py", "drivers/slabcell_drivers/robot/link_events.py"),
    "drivers/slabcell_drivers/robot/eki/link.py",
)
ELSEWHERE: Final = {
    "calibration/charuco.py": "types",
    "vision/overlay.py": "drawn into pictures of the command line",
    "template/dxf.py": "written into files",
    "cell/schema.py": "SQL",
    "cell/ledger_export.py": "the command line's",
    "cell/bundle.py": "faults of the programmer",
    "cell/asbuilt.py": "written into files",
    "service/api/openapi.py": "the API's description",
    "service/api/problems.py": "titles of problems; pages show their details",
    "service/api/server.py": "before there is an API",
    "service/api/stream.py": "the protocol of events",
    "service/api/peer.py": "names in records",
    "service/bench/wire.py": "between two processes of the daemon",
    "service/daemon.py": "before there is an API, or after",
    "service/demo.py": "the command line's",
    "service/demo_cell.py": "the command line's",
    "service/demo_pictures.py": "the command line's",
    "service/doctor_checks.py": "titles, which the page Doctor has by number",
    "service/event_feed.py": "the API's description",
    "service/install.py": "the command line's",
    "service/install_release.py": "the command line's",
    "service/metrics.py": "for Prometheus",
    "service/recipe_text.py": "written into files",
    "service/watchdog.py": "the service manager's",
    "camera/gvcp.py": "the command line's",
    "camera/pixel_formats.py": "",
    "camera/stream_test.py": "the command line's",
}
"""Files of these rooms whose texts no page shows, and why."""
NOT_SAID: Final = frozenset(
    {"Endpoint", "Field", "cast", "field", "get_logger", "compile", "execute", "executemany", "Row", "removeprefix"}
)
"""Calls whose texts are nobody's to read: those of the log are known by ``_log``."""
WRITTEN: Final = frozenset(
    {
        *("# name: {0}", "Recipe {0}, based on {1}, saved over the control API.", "value = {0}", "{0} {1}x{2}"),
        *("Version {0} of {1}, based on {2}, saved over the control API.", "{0}: frame.png", "{0}: calibration.json"),
        *("max-age=3600, immutable", "max-age=600, immutable", "Cell is busy. Ask again.", "harvesters {0} output"),
        *("harvesters {0}", "Err {0}\r\n", "dict[str, object]"),
    }
)
"""What is written into files and headers, or to the robot and other devices."""
_WORD: Final = re.compile(r"[A-Za-z]{3}|\bis\b")
_SQL: Final = re.compile(
    r"\s*(SELECT|PRAGMA|CREATE|INSERT|UPDATE|DELETE)\b|.*\bWHERE\b|.* [<>=]+ (\?|\d+)\b|.* [<>=]+ \?$", re.DOTALL
)
_NAMED_PLACE: Final = re.compile(r"\{[a-z_0-9]+(?::[^}]*)?\}")


def messages() -> dict[str, str]:
    """Return every message with its places as {0}, {1}, ..., and in which file it stands."""
    found: dict[str, str] = {}
    for room in ROOMS:
        for path in sorted(ROOT.glob(room)):
            name = "/".join(path.parts[-2:])
            if not any(path.as_posix().endswith(f"/{other}") for other in ELSEWHERE):
                for text in _texts(ast.parse(path.read_text())):
                    found.setdefault(text, name)
    return found


def _texts(node: ast.AST) -> Iterator[str]:
    """Yield the sentences of a piece of source, those inside of the places of others too."""
    if isinstance(node, ast.Call) and _is_not_said(node.func):
        return
    if _is_text(node):
        parts = list(_parts(node))
        yield from (text for part in parts if isinstance(part, ast.AST) for text in _texts(part))
        message = _numbered(parts)
        literal = re.sub(r"\{\d+\}", "", message)
        if " " in message.strip() and _WORD.search(literal) and not _SQL.match(message) and message not in WRITTEN:
            yield message
        return
    for child in ast.iter_child_nodes(node):
        is_docstring = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
        is_type = isinstance(node, (ast.arg, ast.AnnAssign, ast.FunctionDef)) and child is _type_of(node)
        if not is_docstring and not is_type:
            yield from _texts(child)


def _type_of(node: ast.arg | ast.AnnAssign | ast.FunctionDef) -> ast.expr | None:
    return node.returns if isinstance(node, ast.FunctionDef) else node.annotation


def _is_not_said(function: ast.expr) -> bool:
    if isinstance(function, ast.Subscript):
        return _is_not_said(function.value)
    called = function.attr if isinstance(function, ast.Attribute) else ast.unparse(function)
    return called in NOT_SAID or "_log." in ast.unparse(function)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.Add) and (_is_text(node.left) or _is_text(node.right))
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _parts(node: ast.AST) -> Iterator[str | ast.AST]:
    """Yield what a text is made of, in order: literal texts, and what stands at the places between them."""
    if isinstance(node, ast.BinOp) and _is_text(node):
        yield from _parts(node.left)
        yield from _parts(node.right)
    elif isinstance(node, ast.JoinedStr):
        for part in node.values:
            yield part.value if isinstance(part, ast.FormattedValue) else str(part.value)  # type: ignore[attr-defined]
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield from _of_format(node.value)
    else:
        yield node


def _of_format(text: str) -> Iterator[str | ast.AST]:
    """Yield the parts of a text that may be filled in by ``str.format``."""
    pieces = _NAMED_PLACE.split(text)
    for number, piece in enumerate(pieces):
        if number:
            yield ast.Constant(None)
        yield piece


def _numbered(parts: list[str | ast.AST]) -> str:
    places = iter(range(100))
    return "".join(part if isinstance(part, str) else f"{{{next(places)}}}" for part in parts)
