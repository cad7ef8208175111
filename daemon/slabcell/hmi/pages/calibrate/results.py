"""What came of it?  Compute in the background, show residuals and hold-out, before and after; activate."""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import quote

from starlette.responses import Response

from slabcell.errors import SlabcellError
from slabcell.hmi.cell_api import Json
from slabcell.hmi.pages.calibrate.drawing import draw_coverage, draw_moves
from slabcell.hmi.pages.calibrate.wizard import kind_of, numbers
from slabcell.hmi.route import get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["ROUTES", "compared"]

TEXT_BYTES: Final = 12 << 10
MODELS: Final = ("brown5", "brown4", "brown8", "brown14", "fisheye")
MOUNTS: Final = ("eye-to-hand", "eye-in-hand")


async def _run(visit: Visit) -> Response:
    kind = kind_of(visit)
    body: Json = {"kind": kind}
    if kind == "camera":
        body["model"] = _one_of(visit, "model", MODELS)
    else:
        body["calibration"] = visit.text("base") or None
    if kind == "plane":
        body["board_thickness_mm"] = (numbers(visit, "thickness", 1) or [0.0])[0]
        body["touch"] = _touched(visit)
    if kind == "hand-eye":
        body["mount"] = _one_of(visit, "mount", MOUNTS)
        body["photo_pose"] = numbers(visit, "photo_pose", 6)
    task = await visit.hmi.api.post("/v1/calibration/run", body, user=visit.user.name, key=visit.key())
    visit.outcome = str(task["title"])
    return await _shown(visit, task, kind)


def _one_of(visit: Visit, name: str, known: tuple[str, ...]) -> str:
    value = visit.text(name) or known[0]
    if value not in known:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no")
    return value


def _touched(visit: Visit) -> list[Json]:
    """Return the touched points of a text: view, column, row, x, y in each line, or u, v, x, y."""
    found: list[Json] = []
    for line in visit.text("touch", most=TEXT_BYTES).splitlines():
        if not line.strip() or line.strip()[0].isalpha():
            continue
        try:
            values = [float(part) for part in re.split(r"[;,\s]+", line.strip())]
        except ValueError:
            values = []
        match values:
            case [view, column, row, x, y] if all(value == int(value) for value in (view, column, row)):
                found.append({"view": int(view), "column": int(column), "row": int(row), "x": x, "y": y})
            case [u, v, x, y]:
                found.append({"u": u, "v": v, "x": x, "y": y})
            case _:
                raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "wrong_touch", line=line[:80])
    return found


async def _result(visit: Visit) -> Response:
    name, kind = visit.text("task", most=64), kind_of(visit)
    if not (name.isascii() and name.isalnum()):
        return visit.fragment("result.html", task=None, kind=kind, report=None)
    return await _shown(visit, await visit.hmi.api.get(f"/v1/tasks/{name}"), kind)


async def _shown(visit: Visit, task: Json, kind: str) -> Response:
    task = visit.words.said_in(task)
    values: dict[str, Any] = {"task": task, "kind": kind, "report": None, "drawn": None, "compare": None, "name": ""}
    if task["state"] == "done":
        report, name = task["result"]["report"], task["result"]["calibration"]
        values |= {"report": report, "name": name, "compare": await compared(visit, name, "")}
        if kind == "camera":
            values["drawn"] = draw_coverage(report["coverage"], report["residuals"])
    return visit.fragment("result.html", **values)


async def compared(visit: Visit, after: str, before: str) -> dict[str, Any] | None:
    """Return two calibrations beside each other, to be shown; None where there is nothing to compare with."""
    try:
        found = await visit.hmi.api.get(f"/v1/calibrations/{quote(after, safe='')}/compare", base=before)
    except SlabcellError:
        return None
    return {**found, "movers": draw_moves(found["moved"], found["width"])}


async def _activate(visit: Visit) -> Response:
    done = await visit.post(f"/v1/calibrations/{quote(visit.text('name'), safe='')}/activate")
    visit.hmi.link.tell("calibration")
    return done


ROUTES = (
    post("/calibrate/run", _run, Role.ENGINEER),
    get("/calibrate/result", _result, Role.ENGINEER),
    post("/calibrate/activate", _activate, Role.ENGINEER),
)
