"""Which patterns can the cell lay?  Every recipe's template drawn with what is found about it; new ones are sent here.

A file is sent as it is and read by the daemon's bench, CSV or DXF; nothing of it is kept here.  What a person saves
comes back out of the page as CSV, and is checked by the daemon once more.
"""

from __future__ import annotations

import json
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import quote, urlencode

from starlette.responses import Response

from slabcell.errors import TemporaryError, UnavailableError
from slabcell.hmi.cell_api import Json
from slabcell.hmi.pages.templates.pattern import draw_pattern
from slabcell.hmi.route import HmiRoute, Page, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["PAGE"]

UNITS: Final = ("mm", "cm", "dm", "m", "in", "ft")
FILE_BYTES: Final = 8 << 20
CSV_CHARACTERS: Final = 2 << 20
"""As many as the daemon keeps of a template that comes with parameters."""
SAVE_BYTES: Final = 3 * CSV_CHARACTERS + (64 << 10)
"""Of a form that carries a template: commas take three bytes each in it."""
BENCH_S: Final = 90.0
"""The daemon's bench works beside the cell at the lowest priority: on a busy computer that takes its time."""


async def _recipes(visit: Visit) -> list[Json]:
    return (await visit.hmi.api.get("/v1/recipes"))["recipes"]


async def _page(visit: Visit) -> Response:
    recipes = await _recipes(visit)
    shown = visit.text("recipe") or next((item["name"] for item in recipes if item["active"]), "")
    return visit.page("templates.html", recipes=recipes, shown=shown, units=UNITS, most_bytes=FILE_BYTES)


async def _shelf(visit: Visit) -> Response:
    return visit.fragment("shelf.html", recipes=await _recipes(visit), shown=visit.text("recipe"))


async def _view(visit: Visit) -> Response:
    recipes = await _recipes(visit)
    name = visit.text("recipe") or next((item["name"] for item in recipes if item["active"]), "")
    try:
        path = f"/v1/recipes/{quote(name, safe='')}/template"
        found = await visit.hmi.api.get(path, timeout_s=BENCH_S)
    except (TemporaryError, UnavailableError):  # the bench waits for the cell: the page asks again
        return visit.fragment("waiting.html", shown=name)
    entry = next((item for item in recipes if item["name"] == name), None)
    return _shown(visit, found, title=name, entry=entry)


async def _check(visit: Visit) -> Response:
    """Answer with what is found about a file that was sent; ``file`` is what it is called, for people."""
    query = {name: text for name in ("recipe", "unit", "layers") if (text := visit.text(name, most=400))}
    path = f"/v1/templates/check?{urlencode(query)}" if query else "/v1/templates/check"
    found = await visit.hmi.api.send(
        path, visit.raw, "application/octet-stream", user=visit.user.name, key=visit.key(), timeout_s=BENCH_S
    )
    file, csv = visit.text("file"), found["csv"]
    visit.outcome = visit.words("checked", file=file, count=len(found["findings"]))
    if not csv and found["usable"]:
        csv = visit.raw.decode("utf-8-sig")
    base = query.get("recipe", "")
    known = (await visit.hmi.api.get(f"/v1/recipes/{quote(base, safe='')}"))["parameters"] if base else None
    usual = known["template"]["thickness_mm"] if known else 10.0
    usual, others = _thickness([slot["thickness_mm"] for slot in found["slots"]], usual)
    new = {"csv": csv, "base": base, "name": _recipe_name(file), "thickness_mm": usual, "others": json.dumps(others)}
    return _shown(visit, found, title=file, new=new if found["usable"] else None)


def _thickness(said: list[float | None], usual: float) -> tuple[float, list[Json]]:
    """Return the commonest thickness that a drawing says, and the slots of another, as a recipe has them."""
    slots: dict[float, list[int]] = {}
    for number, value in enumerate(said):
        slots.setdefault(usual if value is None else value, []).append(number)
    commonest = max(slots, key=lambda value: len(slots[value]), default=usual)
    others = [{"slots": numbers, "thickness_mm": value} for value, numbers in slots.items() if value != commonest]
    return commonest, others


def _recipe_name(file: str) -> str:
    """Return a file's name as that of a recipe may be."""
    stem = file.rpartition("/")[2].rpartition("\\")[2].rpartition(".")[0]
    plain = "".join(sign if sign.isascii() and (sign.isalnum() or sign in "._-") else "-" for sign in stem)
    return plain.lstrip("._-")[:60]


def _shown(
    visit: Visit, found: Json, *, title: str, entry: Json | None = None, new: dict[str, Any] | None = None
) -> Response:
    pattern = draw_pattern(visit.words, found)
    return visit.fragment(
        "view.html", found=found, pattern=pattern, title=title, entry=entry, new=new, most_characters=CSV_CHARACTERS
    )


async def _save(visit: Visit) -> Response:
    """Keep a template as a recipe of its own: parameters of the base, but for what belongs to its old template."""
    base, name = visit.text("base"), visit.text("name")
    try:
        thickness_mm = float(visit.text("thickness_mm").replace(",", "."))
        others = json.loads(visit.text("others", most=60_000) or "[]")
    except ValueError as error:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "bad_thickness") from error
    csv = visit.text("csv", most=CSV_CHARACTERS)
    api = visit.hmi.api
    parameters = (await api.get(f"/v1/recipes/{quote(base, safe='')}"))["parameters"]
    parameters["template"] = {"thickness_mm": thickness_mm, "other_thickness": others}
    parameters["grasp"]["forbidden"] = []
    saved = await api.post(
        f"/v1/recipes/{quote(base, safe='')}/versions",
        {"parameters": parameters, "template_csv": csv, "name": name},
        user=visit.user.name,
        key=visit.key(),
    )
    return visit.done(visit.words("saved", name=saved["name"]), "templates")


async def _use(visit: Visit) -> Response:
    name = visit.text("name")
    await visit.hmi.api.post(
        f"/v1/recipes/{quote(name, safe='')}/activate", user=visit.user.name, key=visit.key(), timeout_s=120.0
    )
    return visit.done(visit.words("used", name=name), "templates")


PAGE = Page(
    "templates",
    "/templates",
    Role.VIEWER,
    50,
    (
        get("/templates", _page, Role.VIEWER),
        get("/templates/shelf", _shelf, Role.VIEWER),
        get("/templates/view", _view, Role.VIEWER),
        HmiRoute("POST", "/templates/check", _check, Role.ENGINEER, FILE_BYTES, "application/octet-stream"),
        HmiRoute("POST", "/templates/save", _save, Role.ENGINEER, SAVE_BYTES),
        HmiRoute("POST", "/templates/use", _use, Role.ENGINEER),
    ),
)
