"""May I have a look?  A picture on request, or the verification of what was laid.

Both use the cell's camera and its vision, so both are refused while a robot program runs: they must not make it wait.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slabcell.catalogue import Fault
from slabcell.cell.states import CellState
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import CycleDocument, Document, FrameDocument, PlacementDocument
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.resources.frames import latest_view
from slabcell.service.api.views import cycle_view, placement_view

__all__ = ["ENDPOINTS", "VerificationDocument", "require_idle_robot"]


class VerificationDocument(Document):
    """How the laid slabs lie."""

    schema_: Literal["slabcell.verification/1"] = Field(default="slabcell.verification/1", alias="schema")
    job: int
    placements: list[PlacementDocument]


def require_idle_robot(context: ApiContext) -> None:
    """Raise ProblemError 409 while a robot might have to wait: one is connected, and the cell is not halted."""
    if context.robot.connected and context.cell.state is not CellState.HALTED:
        msg = "a robot is connected, and must not wait: halt the cell first, or end the robot program"
        raise ProblemError(409, msg, number=Fault.NOT_READY)


async def _trigger(call: Call[ApiContext]) -> CycleDocument:
    require_idle_robot(call.context)
    return cycle_view(await call.context.cell.look(), ended=True)


async def _take(call: Call[ApiContext]) -> FrameDocument:
    require_idle_robot(call.context)
    await call.context.cell.snap()
    return latest_view(call.context)


async def _verify(call: Call[ApiContext]) -> VerificationDocument:
    context = call.context
    require_idle_robot(context)
    placements = await context.cell.verify()
    job = context.cell.job
    return VerificationDocument(job=job.job_id if job else 0, placements=[placement_view(item) for item in placements])


_TAG = "looking"
ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/trigger", "Take a picture and see what could be laid; nothing is offered or written", _trigger),
        *(CycleDocument, _TAG),
        problems=(503,),
    ),
    Endpoint(
        *("POST", "/v1/frames/take", "Take a picture and only show it; nothing is looked for in it", _take),
        *(FrameDocument, _TAG),
        problems=(503,),
        kept=False,
    ),
    Endpoint(
        *("POST", "/v1/verify", "Measure how the slabs of the present job lie; the arm must be out of view", _verify),
        *(VerificationDocument, _TAG),
        problems=(503,),
    ),
)
