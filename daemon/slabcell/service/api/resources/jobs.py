"""Which jobs were there, how far is the present one, and what became of each result?"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import JobDocument, JobsDocument, LedgerDocument, SlotsDocument
from slabcell.service.api.endpoint import Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.views import offer_view, placement_view
from slabcell.service.ledger_view import JobRow, count_slots

__all__ = ["ENDPOINTS", "present_job"]

MAX_PAGE: Final = 100
FIRST: Final = 1 << 60


class JobsQuery(Query):
    """Which page."""

    limit: Annotated[int, Field(ge=1, le=MAX_PAGE)] = Field(default=20, description="at most so many")
    before: Annotated[int, Field(ge=1)] = Field(default=FIRST, description="only jobs with a number below this")
    state: Literal["open", "complete", "abandoned"] | None = Field(default=None, description="only jobs in this state")


async def present_job(context: ApiContext) -> JobDocument | None:
    """Return the job that is open, or was just finished, with its slots."""
    job = context.cell.job
    row = await context.ledger.job(job.job_id) if job is not None else None
    return (await _with_slots(context, [row]))[0] if row is not None else None


async def _with_slots(context: ApiContext, rows: list[JobRow]) -> list[JobDocument]:
    offers = await context.ledger.offers([row.job_id for row in rows])
    cell = context.cell
    documents: list[JobDocument] = []
    for row in rows:
        counts = count_slots(
            row.slots,
            offers[row.job_id],
            attempts=cell.settings.attempts_per_slot,
            forgiven_up_to=cell.forgiven_up_to if cell.job and cell.job.job_id == row.job_id else 0,
        )
        documents.append(
            JobDocument(
                job=row.job_id,
                robot_job=row.robot_job,
                recipe=row.recipe,
                template_sha256=row.template_sha256,
                state=row.state,  # pyright: ignore[reportArgumentType]  (the model checks it)
                began=row.began_utc,
                ended=row.ended_utc,
                correction_x_mm=row.correction_x_mm,
                correction_y_mm=row.correction_y_mm,
                slots=SlotsDocument(
                    total=row.slots,
                    laid=counts.laid,
                    under_way=counts.under_way,
                    free=counts.free,
                    given_up=counts.given_up,
                    unknown=counts.unknown,
                ),
            )
        )
    return documents


async def _list(call: Call[ApiContext]) -> JobsDocument:
    query = call.query
    rows = await call.context.ledger.jobs(before=query.before, limit=query.limit + 1, state=query.state)
    jobs = await _with_slots(call.context, rows[: query.limit])
    return JobsDocument(jobs=jobs, before=jobs[-1].job if len(rows) > query.limit else None)


async def _present(call: Call[ApiContext]) -> LedgerDocument:
    job = await present_job(call.context)
    if job is None:
        raise ProblemError(404, "the cell has no job: one begins with the robot's next trigger")
    return await _ledger(call.context, job)


async def _one(call: Call[ApiContext]) -> LedgerDocument:
    number = call.number("job")
    row = await call.context.ledger.job(number)
    if row is None:
        raise ProblemError(404, f"the ledger has no job {number}")
    return await _ledger(call.context, (await _with_slots(call.context, [row]))[0])


async def _ledger(context: ApiContext, job: JobDocument) -> LedgerDocument:
    offers = (await context.ledger.offers([job.job]))[job.job]
    placements = await context.ledger.placements(job.job)
    return LedgerDocument(
        job=job,
        offers=[offer_view(offer) for offer in offers],
        placements=[placement_view(item) for item in placements],
    )


_TAG = "jobs"
ENDPOINTS = (
    Endpoint("GET", "/v1/jobs", "Jobs, the newest first", _list, JobsDocument, _TAG, query=JobsQuery, problems=(409,)),
    Endpoint(
        *("GET", "/v1/jobs/current", "The present job: its slots, its results, and how its slabs lie", _present),
        *(LedgerDocument, _TAG),
        problems=(404, 409),
    ),
    Endpoint(
        *("GET", "/v1/jobs/{job}", "One job out of the ledger", _one, LedgerDocument, _TAG),
        problems=(404, 409),
    ),
)
