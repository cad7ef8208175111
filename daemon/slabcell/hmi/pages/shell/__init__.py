"""What belongs to every page?  The line at the top, and the newest camera picture as a file."""

from __future__ import annotations

from starlette.responses import JSONResponse, Response

from slabcell.hmi.route import Page, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["PAGE"]


async def _header(visit: Visit) -> Response:
    return visit.base_fragment("header.html")


async def _latest(visit: Visit) -> Response:
    return JSONResponse(await visit.hmi.api.get("/v1/frames/latest"))


async def _latest_png(visit: Visit) -> Response:
    answer = await visit.hmi.api.fetch("/v1/frames/latest.png")
    return Response(answer.content, media_type="image/png", headers={"etag": answer.etag})


async def _latest_jpg(visit: Visit) -> Response:
    answer = await visit.hmi.api.fetch("/v1/frames/latest.jpg")
    return Response(answer.content, media_type="image/jpeg", headers={"etag": answer.etag})


PAGE = Page(
    "shell",
    "/header",
    Role.VIEWER,
    None,
    (
        get("/header", _header, Role.VIEWER),
        get("/frames/latest.json", _latest, Role.VIEWER),
        get("/frames/latest.png", _latest_png, Role.VIEWER),
        get("/frames/latest.jpg", _latest_jpg, Role.VIEWER),
    ),
)
