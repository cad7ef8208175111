"""Which calibrations were there?  With their figures, two beside each other, to download, to upload, to use again."""

from __future__ import annotations

import json
from typing import Any, Final
from urllib.parse import quote

from starlette.responses import JSONResponse, Response

from slabcell.hmi.pages.calibrate.results import compared
from slabcell.hmi.route import HmiRoute, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["ROUTES"]

MAX_BYTES: Final = 4 << 20


async def _values(visit: Visit) -> dict[str, Any]:
    found = (await visit.hmi.api.get("/v1/calibrations"))["calibrations"]
    return {"calibrations": found, "tab": "history"}


async def _page(visit: Visit) -> Response:
    return visit.page("history.html", **await _values(visit))


async def _list(visit: Visit) -> Response:
    return visit.fragment("list.html", **await _values(visit))


async def _compare(visit: Visit) -> Response:
    after, before = visit.text("after"), visit.text("before")
    found = await compared(visit, after, before) if after else None
    return visit.fragment("compared.html", compare=found, asked=bool(after))


async def _file(visit: Visit) -> Response:
    name = visit.text("name") or "configured"
    found = await visit.hmi.api.get(f"/v1/calibrations/{quote(name, safe='')}")
    plain = "".join(sign for sign in name if sign.isascii() and (sign.isalnum() or sign in "-_"))
    headers = {"content-disposition": f'attachment; filename="calibration-{plain}.json"'}
    return Response(json.dumps(found["calibration"], indent=1), media_type="application/json", headers=headers)


async def _upload(visit: Visit) -> Response:
    api = visit.hmi.api
    done = await api.send("/v1/calibrations", visit.raw, "application/json", user=visit.user.name, key=visit.key())
    visit.outcome = str(done["name"])
    visit.hmi.link.tell("calibration")
    return JSONResponse({"said": visit.words("uploaded", name=done["name"])})


ROUTES = (
    get("/calibrate/history", _page, Role.VIEWER),
    get("/calibrate/list", _list, Role.VIEWER),
    get("/calibrate/compare", _compare, Role.VIEWER),
    get("/calibrate/file", _file, Role.VIEWER),
    HmiRoute("POST", "/calibrate/upload", _upload, Role.ENGINEER, MAX_BYTES, "application/json"),
)
