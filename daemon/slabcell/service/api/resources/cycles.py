"""Which cycles were there?  Page by page, each with its stage times and poses, its picture and its files."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from typing import Annotated, Final

from pydantic import Field
from starlette.responses import FileResponse, Response

from slabcell.cell.bundle_file import BundleError
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import CycleDocument, CyclesDocument
from slabcell.service.api.endpoint import Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.bundles import MEMBERS
from slabcell.service.history import CycleRow

__all__ = ["ENDPOINTS", "cycle_row"]

MAX_PAGE: Final = 200
FIRST: Final = 1 << 60


class CyclesQuery(Query):
    """Which cycles, and which page of them."""

    limit: Annotated[int, Field(ge=1, le=MAX_PAGE)] = Field(default=50, description="at most so many")
    before: Annotated[int, Field(ge=1)] = Field(default=FIRST, description="only cycles with a number below this")
    job: Annotated[int, Field(ge=0)] | None = Field(default=None, description="only cycles of this job")
    code: Annotated[int, Field(ge=0, le=99_999)] | None = Field(default=None, description="only with this code")
    since: datetime | None = Field(default=None, description="only cycles that began then or later, ISO 8601")
    until: datetime | None = Field(default=None, description="only cycles that began before, ISO 8601")
    failed: bool = Field(default=False, description="only cycles that ended with a number of the error catalogue")


def _view(row: CycleRow) -> CycleDocument:
    return CycleDocument.model_validate_json(row.document).model_copy(update={"bundle": row.bundle})


def _utc(moment: datetime | None) -> str | None:
    """Return a moment as the history stamps it; one without a zone is UTC."""
    if moment is None:
        return None
    zoned = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return zoned.astimezone(UTC).isoformat(timespec="milliseconds")


async def cycle_row(context: ApiContext, number: int) -> CycleRow:
    """Return one ended cycle.  Raises ProblemError 404."""
    row = await context.history.read(lambda file: file.cycle(number))
    if row is None:
        raise ProblemError(404, f"there is no cycle {number}, or not any more")
    return row


async def _list(call: Call[ApiContext]) -> CyclesDocument:
    query: CyclesQuery = call.query
    rows = await call.context.history.read(
        lambda file: file.cycles(
            before=query.before,
            limit=query.limit + 1,
            job=query.job,
            code=query.code,
            failed=query.failed,
            since_utc=_utc(query.since),
            until_utc=_utc(query.until),
        )
    )
    cycles = [_view(row) for row in rows[: query.limit]]
    return CyclesDocument(cycles=cycles, before=cycles[-1].cycle if len(rows) > query.limit else None)


async def _one(call: Call[ApiContext]) -> CycleDocument:
    return _view(await cycle_row(call.context, call.number("cycle")))


async def _bundle(call: Call[ApiContext]) -> Response:
    row = await cycle_row(call.context, call.number("cycle"))
    try:
        path = await asyncio.to_thread(call.context.bundles.path, row.bundle)
    except BundleError as error:
        raise ProblemError(404, str(error)) from error
    return FileResponse(path, media_type="application/zip", filename=row.bundle)


async def _member(call: Call[ApiContext]) -> Response:
    name = call.text("file")
    if name not in MEMBERS:
        raise ProblemError(404, f"{name!r:.40} is no file of a cycle; there are {', '.join(MEMBERS)}")
    row = await cycle_row(call.context, call.number("cycle"))
    try:
        content = await asyncio.to_thread(call.context.bundles.member, row.bundle, name)
    except BundleError as error:
        raise ProblemError(404, str(error)) from error
    return Response(content, media_type=MEMBERS[name], headers={"cache-control": "max-age=3600, immutable"})


_TAG = "cycles"
ENDPOINTS = (
    Endpoint("GET", "/v1/cycles", "Ended cycles, the newest first", _list, CyclesDocument, _TAG, query=CyclesQuery),
    Endpoint("GET", "/v1/cycles/{cycle}", "One ended cycle", _one, CycleDocument, _TAG, problems=(404,)),
    Endpoint(
        *("GET", "/v1/cycles/{cycle}/bundle", "Everything that is kept of a cycle, for slabcell replay", _bundle),
        *("application/zip", _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("GET", "/v1/cycles/{cycle}/files/{file}", f"A file of a cycle: {', '.join(MEMBERS)}", _member),
        *("application/octet-stream", _TAG),
        problems=(404,),
    ),
)
