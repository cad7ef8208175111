"""Which cycles were there?  Filtered, page by page; each with its picture, what was found in it, times and files."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import urlencode

from starlette.responses import JSONResponse, Response

from slabcell.errors import SlabcellError, UnavailableError
from slabcell.hmi.pages.overview.bars import stage_bars
from slabcell.hmi.route import get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["ROUTES"]

ROWS: Final = 30
NOTHING_FOUND: Final = {"parts": (), "rejected": ()}
FILES: Final = {
    "frame.png": "image/png",
    "result.json": "application/json",
    "overlay.json": "application/json",
    "transcript.json": "application/json",
    "telegrams.json": "application/json",
    "as-built.json": "application/json",
    "as-built.csv": "text/csv",
    "as-built.svg": "image/svg+xml",
}


def _filter(visit: Visit) -> tuple[dict[str, Any], dict[str, str]]:
    """Return what the API is asked, and the fields as they were filled in."""
    shown = {name: visit.text(name) for name in ("failed", "job", "code", "since", "until")}
    query: dict[str, Any] = {"limit": ROWS}
    if shown["failed"]:
        query["failed"] = True
    for name in ("job", "code", "before"):
        number = visit.number(name)
        if number is not None:
            query[name] = number
    for name in ("since", "until"):
        if shown[name]:
            query[name] = _moment(name, shown[name])
    return query, {name: value for name, value in shown.items() if value}


def _moment(name: str, text: str) -> str:
    """Return a moment as a browser gives it, in the time zone of this computer, as UTC.  Raises Refusal."""
    try:
        return datetime.fromisoformat(text).astimezone(UTC).isoformat()
    except (ValueError, OverflowError) as error:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no_number", name=name, value=text[:40]) from error


async def _values(visit: Visit) -> dict[str, Any]:
    query, shown = _filter(visit)
    found = await visit.hmi.api.get("/v1/cycles", **query)
    older = urlencode({**shown, "before": found["before"]}) if found["before"] else ""
    return {"cycles": found["cycles"], "older": older, "shown": shown, "chosen": None}


async def _page(visit: Visit) -> Response:
    values = await _values(visit)
    cycle = values["cycles"][0] if values["cycles"] else None
    return visit.page("cycles.html", tab="cycles", **(values | _one(cycle)))


async def _rows(visit: Visit) -> Response:
    return visit.fragment("rows.html", **await _values(visit))


def _one(cycle: dict[str, Any] | None) -> dict[str, Any]:
    return {"cycle": cycle, "bars": stage_bars(cycle["times_ms"]) if cycle else [], "chosen": cycle and cycle["cycle"]}


async def _cycle(visit: Visit) -> Response:
    number = visit.number("cycle")
    cycle = await visit.hmi.api.get(f"/v1/cycles/{number}")
    if visit.wants_fragment:
        return visit.fragment("cycle.html", **_one(cycle))
    values = await _values(visit)
    return visit.page("cycles.html", tab="cycles", **(values | _one(cycle)))


async def _file(visit: Visit) -> Response:
    number, name = visit.number("cycle"), str(visit.request.path_params["file"])
    media_type = FILES.get(name)
    if media_type is None:
        raise Refusal(HTTPStatus.NOT_FOUND, "refused.no_page")
    try:
        answer = await visit.hmi.api.fetch(f"/v1/cycles/{number}/files/{name}")
    except UnavailableError:
        raise
    except SlabcellError:
        if name != "overlay.json":
            raise
        return JSONResponse(NOTHING_FOUND)  # a verification, or a cycle that failed before anything was located
    if name == "overlay.json" and not visit.text("download"):
        return JSONResponse(visit.words.said_in(json.loads(answer.content)))
    headers = {"cache-control": "private, max-age=3600"}
    if visit.text("download"):
        headers["content-disposition"] = f'attachment; filename="cycle-{number}-{name}"'
    return Response(answer.content, media_type=media_type, headers=headers)


async def _bundle(visit: Visit) -> Response:
    number = visit.number("cycle")
    answer = await visit.hmi.api.fetch(f"/v1/cycles/{number}/bundle")
    headers = {"content-disposition": f'attachment; filename="cycle-{number}.zip"'}
    return Response(answer.content, media_type="application/zip", headers=headers)


ROUTES = (
    get("/history", _page, Role.VIEWER),
    get("/history/rows", _rows, Role.VIEWER),
    get("/history/cycles/{cycle}", _cycle, Role.VIEWER),
    get("/history/cycles/{cycle}/files/{file}", _file, Role.VIEWER),
    get("/history/cycles/{cycle}/bundle", _bundle, Role.VIEWER),
)
