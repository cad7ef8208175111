"""What would these parameters make of a picture?  Previews, their buffers, and runs over sets of pictures."""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import quote

from starlette.responses import JSONResponse, Response

from slabcell.hmi.cell_api import Json
from slabcell.hmi.pages.tune.answers import answer, ask, json_post, said
from slabcell.hmi.route import HmiRoute, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["ROUTES"]

MAX_UPLOAD_BYTES: Final = 32 << 20
CANDIDATE: Final = ("base", "parameters", "everywhere")
REFUSED_POINTS: Final = 4000
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,80}")


async def _preview(visit: Visit) -> Response:
    content = said(visit, "base", "picture")

    async def work() -> Json:
        if content.get("live"):
            await ask(visit, "/v1/frames/take")
        return _slim(await ask(visit, "/v1/vision/preview", _chosen(content, *CANDIDATE, "picture")))

    return await answer(visit, work())


async def _run(visit: Visit) -> Response:
    content = said(visit, "base")
    return await answer(visit, ask(visit, "/v1/vision/run", _chosen(content, *CANDIDATE, "pictures")))


async def _buffer(visit: Visit) -> Response:
    names = [str(visit.request.path_params[name]) for name in ("preview", "buffer")]
    if not all(map(_NAME.fullmatch, names)):
        raise Refusal(HTTPStatus.NOT_FOUND, "refused.no_page")
    found = await visit.hmi.api.fetch(f"/v1/vision/previews/{names[0]}/{names[1]}")
    return Response(found.content, media_type=found.media_type, headers={"cache-control": "private, max-age=600"})


async def _sets(visit: Visit) -> Response:
    recipe = visit.text("recipe")
    query: dict[str, Any] = {"recipe": recipe} if recipe else {}
    return JSONResponse(await visit.hmi.api.get("/v1/vision/sets", **query))


async def _keep(visit: Visit) -> Response:
    content = said(visit, "set", "picture", "name")
    path = f"/v1/vision/sets/{quote(str(content.get('set', '')), safe='')}/keep"
    return await answer(visit, ask(visit, path, _chosen(content, "picture", "name")))


async def _forget(visit: Visit) -> Response:
    content = said(visit, "set", "file")
    path = f"/v1/vision/sets/{quote(str(content.get('set', '')), safe='')}/remove"
    return await answer(visit, ask(visit, path, _chosen(content, "file")))


async def _upload(visit: Visit) -> Response:
    work = visit.hmi.api.send(
        "/v1/vision/pictures", visit.raw, "image/png", user=visit.user.name, key=visit.key(), timeout_s=60.0
    )
    return await answer(visit, work)


async def _task(visit: Visit) -> Response:
    task = await visit.hmi.api.get(f"/v1/tasks/{quote(visit.request.path_params['task'], safe='')}")
    return JSONResponse(visit.words.said_in(task))


async def _cancel(visit: Visit) -> Response:
    content = said(visit, "task")
    return await answer(visit, ask(visit, f"/v1/tasks/{quote(str(content.get('task', '')), safe='')}/cancel"))


def _slim(preview: Json) -> Json:
    """Return a preview whose refused blobs have fewer points: noise has outlines of tens of thousands.

    Each is still drawn where it is; the buffer of contours has all of them.
    """
    rejected = preview["located"]["rejected"] if preview["located"] else ()
    step = -(-sum(len(blob["outline_px"]) for blob in rejected) // REFUSED_POINTS)
    for blob in rejected:
        blob["outline_px"] = blob["outline_px"][:: max(1, step)]
    return preview


def _chosen(content: Json, *names: str) -> Json:
    return {name: content[name] for name in names if name in content}


ROUTES = (
    json_post("/tune/preview", _preview, logged=False),
    get("/tune/previews/{preview}/{buffer}", _buffer, Role.ENGINEER),
    json_post("/tune/run", _run, logged=False),
    get("/tune/sets", _sets, Role.ENGINEER),
    json_post("/tune/keep", _keep),
    json_post("/tune/forget", _forget),
    HmiRoute("POST", "/tune/upload", _upload, Role.ENGINEER, MAX_UPLOAD_BYTES, "application/octet-stream"),
    get("/tune/tasks/{task}", _task, Role.ENGINEER),
    json_post("/tune/cancel", _cancel),
)
