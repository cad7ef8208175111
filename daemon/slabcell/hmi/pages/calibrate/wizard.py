"""Step by step to a calibration: see the board, collect views as advised, compute."""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Any, Final

from starlette.responses import JSONResponse, Response

from slabcell.errors import SlabcellError
from slabcell.hmi.cell_api import Json
from slabcell.hmi.pages.calibrate.drawing import draw_coverage
from slabcell.hmi.route import HmiRoute, get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["KINDS", "ROUTES", "kind_of", "numbers", "usual_board"]

KINDS: Final = ("camera", "plane", "hand-eye")
PLACES: Final = ("held", "table", "flange", "away")
PLACE_OF: Final = {"camera": "held", "plane": "table", "hand-eye": "flange"}
BOARD: Final = "checkerboard:12x9:25"
TEXT_BYTES: Final = 12 << 10
SURVEY_TIMEOUT_S: Final = 60.0


def kind_of(visit: Visit) -> str:
    """Return which calibration the page is about; the lens if it does not say."""
    kind = visit.text("kind")
    return kind if kind in KINDS else KINDS[0]


def numbers(visit: Visit, name: str, count: int) -> list[float] | None:
    """Return so many numbers out of a field, None if it is empty; a decimal comma is right between semicolons."""
    text = visit.text(name).strip()
    if not text:
        return None
    parts = [part.replace(",", ".") for part in text.split(";")] if ";" in text else re.split(r"[,\s]+", text)
    try:
        found = [float(part) for part in parts if part.strip()]
    except ValueError:
        found = []
    if len(found) != count:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "wrong_numbers", count=count, text=text[:80])
    return found


async def simulated(visit: Visit) -> Json | None:
    """Return the board of a simulated cell; None of a real one."""
    try:
        return await visit.hmi.api.get("/v1/simulation/board")
    except SlabcellError:
        return None


async def usual_board(visit: Visit, shown: Json | None) -> tuple[str, float]:
    """Return which board people use here, and its thickness: the simulated one, that of the views, or of the file."""
    if shown is not None:
        return str(shown["board"]), float(shown["thickness_mm"])
    try:
        views = (await visit.hmi.api.get("/v1/calibration/views"))["views"]
        if views:
            return str(views[0]["board"]), 0.0
        found: Json = (await visit.hmi.api.get("/v1/calibration"))["calibration"]["diagnostics"]
    except SlabcellError:
        return BOARD, 0.0
    plane: Json = found.get("plane") or {}
    return str(found.get("board") or BOARD), float(plane.get("board_thickness_mm") or 0.0)


async def _page(visit: Visit) -> Response:
    kind, api = kind_of(visit), visit.hmi.api
    shown = await simulated(visit)
    board, thickness_mm = await usual_board(visit, shown)
    known = await api.get("/v1/calibrations")
    bases = [item for item in known["calibrations"] if not item["problem"]]
    return visit.page(
        "wizard.html",
        tab="wizard",
        board=board,
        thickness_mm=thickness_mm,
        shown=shown,
        place=PLACE_OF[kind],
        bases=bases,
        script_words={name: visit.words(name) for name in ("points_found", "not_found", "view")},
        **await _collected(visit, survey=False),
    )


async def _collected(visit: Visit, *, survey: bool = True) -> dict[str, Any]:
    """Return the views, and with ``survey`` what the bench says of them, which may take its time."""
    kind, api = kind_of(visit), visit.hmi.api
    views = (await api.get("/v1/calibration/views"))["views"]
    values: dict[str, Any] = {"kind": kind, "views": views, "survey": None, "stands": {}, "drawn": None, "advice": ()}
    if not survey:
        return values
    try:
        found = values["survey"] = await api.get("/v1/calibration/survey", timeout_s=SURVEY_TIMEOUT_S, kind=kind)
    except SlabcellError:  # the bench stands still while the cell works: the page asks again
        return values
    values["advice"] = [_said(visit, item) for item in found["advice"]]
    values["stands"] = {stand["name"]: stand for stand in found["stands"]}
    if found["coverage"] is not None:
        values["drawn"] = draw_coverage(found["coverage"])
    return values


def _said(visit: Visit, item: Json) -> str:
    """Return a piece of advice in the language of the page; one that it does not know as the daemon says it."""
    words, values = visit.words, item["values"]
    text = words.maybe(f"advice.{item['code']}", "")
    if not text:
        return words.said(str(item["text"]))
    names = {
        "places": [words.maybe(f"corner.{name.replace(' ', '_')}", name) for name in values.get("places", ())],
        "sides": [words.maybe(f"side.{name}", name) for name in values.get("sides", ())],
        "views": [words.said(name) for name in values.get("views", ())],
    }
    plain = {key: value for key, value in values.items() if key not in names}
    shown = {key: words.number(value, 0) if isinstance(value, float) else value for key, value in plain.items()}
    return text.format(**shown, **{key: ", ".join(value) for key, value in names.items()})


async def _views(visit: Visit) -> Response:
    return visit.fragment("views.html", **await _collected(visit))


async def _look(visit: Visit) -> Response:
    """Take a picture, and find the board in it."""
    api, user = visit.hmi.api, visit.user.name
    frame = await api.post("/v1/frames/take", user=user, key=visit.key())
    board = visit.text("board")
    found = await api.post("/v1/calibration/detect", {"board": board, "picture": "latest"}, user=user, key=visit.key())
    return JSONResponse({**visit.words.said_in(found), "frame": frame["frame"]})


async def _collect(visit: Visit) -> Response:
    pose = visit.text("pose").strip()
    given = pose if pose == "robot" else numbers(visit, "pose", 6)
    body = {"board": visit.text("board"), "picture": "latest", "pose": given if kind_of(visit) == "hand-eye" else None}
    done = await visit.hmi.api.post("/v1/calibration/views", body, user=visit.user.name, key=visit.key())
    return visit.done(visit.words("collected", view=done["view"], points=done["points"]), "views")


async def _remove(visit: Visit) -> Response:
    done = await visit.post(f"/v1/calibration/views/{visit.number('view')}/remove")
    visit.hmi.link.tell("views")
    return done


async def _clear(visit: Visit) -> Response:
    done = await visit.post("/v1/calibration/clear")
    visit.hmi.link.tell("views")
    return done


async def _where(visit: Visit) -> Response:
    return JSONResponse(await visit.hmi.api.get("/v1/calibration/robot-pose"))


async def _poses(visit: Visit) -> Response:
    table = visit.text("poses", most=TEXT_BYTES).strip()
    header = "" if table.lower().startswith("image") else "image,X,Y,Z,A,B,C\n"
    content = f"{header}{table}\n".encode()
    api = visit.hmi.api
    done = await api.send("/v1/calibration/poses", content, "text/csv", user=visit.user.name, key=visit.key())
    known = sum(view["pose"] is not None for view in done["views"])
    return visit.done(visit.words("poses_taken", known=known, all=len(done["views"])), "views")


async def _board(visit: Visit) -> Response:
    place, number = visit.text("place"), visit.number("number") or 0
    if place not in PLACES:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no")
    body = {"place": place, "number": number}
    shown = await visit.hmi.api.post("/v1/simulation/board", body, user=visit.user.name, key=visit.key())
    kind = kind_of(visit)
    return visit.fragment("simulated.html", shown=shown, place=PLACE_OF[kind], kind=kind)


ROUTES = (
    get("/calibrate", _page, Role.VIEWER),
    get("/calibrate/views", _views, Role.VIEWER),
    HmiRoute("POST", "/calibrate/look", _look, Role.ENGINEER, logged=False),
    post("/calibrate/collect", _collect, Role.ENGINEER),
    post("/calibrate/remove", _remove, Role.ENGINEER),
    post("/calibrate/clear", _clear, Role.ENGINEER),
    HmiRoute("POST", "/calibrate/robot-pose", _where, Role.ENGINEER, logged=False),
    post("/calibrate/poses", _poses, Role.ENGINEER),
    post("/calibrate/board", _board, Role.ENGINEER),
)
