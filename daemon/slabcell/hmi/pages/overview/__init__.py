"""What does the cell do, how far is it, and why did it stop?  The first page, to be read from across the hall."""

from __future__ import annotations

from typing import Any

from starlette.responses import Response

from slabcell.errors import SlabcellError
from slabcell.hmi.pages.overview.bars import stage_bars
from slabcell.hmi.route import Page, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["PAGE"]

MAX_ALARMS = 4


async def _values(visit: Visit) -> dict[str, Any]:
    hmi = visit.hmi
    status = hmi.link.status
    values: dict[str, Any] = {"drawing": None, "alarms": [], "bars": []}
    if status is None:
        return values
    if status["cycle"] is not None:
        values["bars"] = stage_bars(status["cycle"]["times_ms"])
    try:
        values["drawing"] = await hmi.template.drawing(status, visit.words("drawing"))
        if status["alarms"]:
            values["alarms"] = (await hmi.api.get("/v1/alarms"))["alarms"][:MAX_ALARMS]
    except SlabcellError:
        if hmi.link.up:
            raise
    return values


async def _page(visit: Visit) -> Response:
    return visit.page("overview.html", **await _values(visit))


async def _cards(visit: Visit) -> Response:
    return visit.fragment("cards.html", **await _values(visit))


PAGE = Page(
    "overview",
    "/",
    Role.VIEWER,
    10,
    (get("/", _page, Role.VIEWER), get("/overview/cards", _cards, Role.VIEWER)),
)
