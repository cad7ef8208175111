"""Can everything that a page does be done by the control API and the command line?  Their table is held to the code."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.main import get_command

from slabcell.cli import app
from slabcell.hmi.pages import PAGES
from slabcell.service.api.app import ENDPOINTS

pytestmark = pytest.mark.unit

REPOSITORY = Path(__file__).parents[2]
ROWS = tomllib.loads((REPOSITORY / "docs" / "reference" / "pages.toml").read_text(encoding="utf-8"))["row"]
HELPERS = {"_path", "path_of"}
"""Functions that put a recipe's resource together: of a name, and of what follows it."""
NOT_ASKED_FOR = {
    "/v1/doctor",  # the command looks itself
    "/v1/events",  # by the client of the API, not by the verb
    "/v1/recipes/active",  # `recipe list` marks it, `recipe show` has it whole
    "/v1/vision/previews/{}/{}",  # `vision preview --out` follows the paths in the answer
    "/v1/frames/latest.jpg",  # the same picture, small
}
"""Of what the pages ask for, what no verb names in its code."""


def asked_for(room: str) -> set[str]:
    """Return the paths of the control API that the source of a room names, ``{}`` for what is filled in."""
    found: set[str] = set()
    for file in (REPOSITORY / "daemon" / "slabcell" / room).rglob("*.py"):
        for text in _texts(ast.parse(file.read_text(encoding="utf-8"))):
            if text.startswith("/v1/"):
                found.add(text.partition("?")[0])
    return found


def _texts(tree: ast.AST) -> Iterator[str]:
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
            yield node.value
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in HELPERS:
            rest = [part.value for part in node.args[1:] if isinstance(part, ast.Constant)]
            yield "/".join(["/v1/recipes/{}", *map(str, rest)])


def shape(path: str) -> str:
    return re.sub(r"\{[^}]*\}", "{}", path)


def test_every_route_of_every_page_stands_in_one_row() -> None:
    listed = [route for row in ROWS for route in row["routes"]]
    served = [f"{route.method} {route.path}" for page in PAGES for route in page.routes]
    assert sorted(listed) == sorted(served)


def test_what_the_pages_ask_for_is_what_the_table_says() -> None:
    said = {shape(request.partition(" ")[2]) for row in ROWS for request in row["api"]}
    # Events are asked for as a plain line of HTTP.
    assert said - {"/v1/events"} == {shape(path) for path in asked_for("hmi")}
    known = {f"{item.method} {item.path}" for item in ENDPOINTS}
    assert {request for row in ROWS for request in row["api"]} <= known


def test_what_the_pages_ask_for_the_command_line_asks_for_too() -> None:
    said = {shape(request.partition(" ")[2]) for row in ROWS for request in row["api"]}
    assert said - asked_for("cli") == NOT_ASKED_FOR


@pytest.mark.parametrize("words", sorted({command for row in ROWS for command in row["commands"]}))
def test_the_verbs_are_there(words: str) -> None:
    verb, *rest = words.split()
    found = get_command(app._build(verb)).commands[verb]  # pyright: ignore[reportPrivateUsage, reportAttributeAccessIssue]
    for word in rest:
        found = found.commands[word]
    assert not hasattr(found, "commands"), words
