"""How does a script of the page ask?  JSON there and back; what was refused comes in words, and alarms nobody."""

from __future__ import annotations

import json
from collections.abc import Awaitable
from http import HTTPStatus
from typing import Any, Final, cast

from starlette.responses import JSONResponse, Response

from slabcell.catalogue import Fault
from slabcell.errors import SlabcellError, TemporaryError, UnavailableError
from slabcell.hmi.cell_api import Json
from slabcell.hmi.route import HmiRoute
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["PARAMETER_BYTES", "answer", "ask", "json_post", "said"]

PARAMETER_BYTES: Final = 1 << 20


def json_post(path: str, handler: Any, *, logged: bool = True) -> HmiRoute:
    """Return a route that takes a JSON object; ``logged`` False for what changes nothing and is asked for often."""
    return HmiRoute("POST", path, handler, Role.ENGINEER, PARAMETER_BYTES, "application/json", logged)


def said(visit: Visit, *shown: str) -> Json:
    """Return the object that came; the fields ``shown`` go into the audit log.  Raises Refusal."""
    try:
        content: object = json.loads(visit.raw)
    except (ValueError, RecursionError) as error:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no") from error
    if not isinstance(content, dict):
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no")
    found = cast("Json", content)
    visit.form = {name: str(found.get(name, "")) for name in shown}
    return found


async def answer(visit: Visit, work: Awaitable[Json]) -> Response:
    """Return what the cell says; of what it refuses ``problem``, and ``busy`` where it is at work and may do it later.

    Both are answers, not failures: a person who tunes sees them where the result would stand.  Raises
    UnavailableError.
    """
    try:
        done = await work
    except UnavailableError:
        raise
    except SlabcellError as error:
        busy = isinstance(error, TemporaryError) or error.number == Fault.NOT_READY
        visit.outcome = str(error)
        return JSONResponse({"problem": visit.words.said(str(error)), "busy": busy})
    return JSONResponse(visit.words.said_in(done))


async def ask(visit: Visit, path: str, body: Json | None = None, *, timeout_s: float = 60.0) -> Json:
    """Have the cell do something for who asks; return its answer.  Raises SlabcellError."""
    return await visit.hmi.api.post(path, body, user=visit.user.name, key=visit.key(), timeout_s=timeout_s)
