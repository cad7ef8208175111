"""What does a person say of slabs and jobs that the cell cannot know of?"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Done
from slabcell.service.api.endpoint import Body, Call, Endpoint

__all__ = ["ENDPOINTS"]


class ResolveBody(Body):
    """What a person saw at the slot."""

    verdict: Literal["placed", "failed"] = Field(description="placed: the slab lies in its slot; failed: it does not")


async def _resolve(call: Call[ApiContext]) -> Done:
    result, body = call.number("result"), call.body
    await call.context.cell.resolve(result, placed=body.verdict == "placed")
    return Done(detail=f"result {result} is {body.verdict}, as {call.peer} saw it")


async def _abandon(call: Call[ApiContext]) -> Done:
    job = await call.context.cell.abandon_job(str(call.peer))
    return Done(detail=f"job {job.job_id} is abandoned; the next trigger begins a new one")


ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/ledger/{result}/resolve", "Say what became of a slab of which nobody knows", _resolve),
        *(Done, "ledger"),
        body=ResolveBody,
    ),
    Endpoint(
        *("POST", "/v1/jobs/current/abandon", "Close the open job before it is complete", _abandon, Done, "jobs"),
    ),
)
