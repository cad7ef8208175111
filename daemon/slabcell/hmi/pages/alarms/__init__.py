"""Which alarms stand, what do they mean, and what is there to do?  And which came before."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any, Final

from starlette.responses import Response

from slabcell.hmi.route import Page, get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["PAGE"]

PAST: Final = 50
SHELVE_S: Final = {"15": 900.0, "60": 3600.0, "480": 28_800.0}
"""Minutes that are offered, and their seconds: a shift at most."""


async def _values(visit: Visit) -> dict[str, Any]:
    standing = await visit.hmi.api.get("/v1/alarms", shelved=True)
    past = await visit.hmi.api.get("/v1/alarms/history", limit=PAST, before=visit.number("before") or 1 << 60)
    return {"alarms": standing["alarms"], "past": past["alarms"], "before": past["before"], "minutes": SHELVE_S}


async def _page(visit: Visit) -> Response:
    return visit.page("alarms.html", **await _values(visit))


async def _list(visit: Visit) -> Response:
    return visit.fragment("list.html", **await _values(visit))


def _number(visit: Visit) -> int:
    number = visit.number("number")
    if number is None:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no")
    return number


async def _acknowledge(visit: Visit) -> Response:
    return await visit.post(f"/v1/alarms/{_number(visit)}/acknowledge")


async def _shelve(visit: Visit) -> Response:
    duration_s = SHELVE_S.get(visit.text("minutes"))
    if duration_s is None:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no")
    return await visit.post(f"/v1/alarms/{_number(visit)}/shelve", {"duration_s": duration_s})


async def _unshelve(visit: Visit) -> Response:
    return await visit.post(f"/v1/alarms/{_number(visit)}/unshelve")


PAGE = Page(
    "alarms",
    "/alarms",
    Role.VIEWER,
    70,
    (
        get("/alarms", _page, Role.VIEWER),
        get("/alarms/list", _list, Role.VIEWER),
        post("/alarms/acknowledge", _acknowledge, Role.OPERATOR),
        post("/alarms/shelve", _shelve, Role.ENGINEER),
        post("/alarms/unshelve", _unshelve, Role.ENGINEER),
    ),
)
