"""What may a person have the cell do?  Halt, go on, one slab at a time, clear, verify.

Nothing here moves the robot: a cell that goes on is one that answers when the robot asks.
"""

from __future__ import annotations

from slabcell.cell.states import CellState
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Done
from slabcell.service.api.endpoint import Call, Endpoint

__all__ = ["ENDPOINTS"]


async def _stop(call: Call[ApiContext]) -> Done:
    await call.context.cell.halt(f"halted by {call.peer}")
    return Done(detail="the cell offers nothing any more; what the robot holds it may still lay down")


async def _start(call: Call[ApiContext]) -> Done:
    await call.context.cell.resume(str(call.peer))
    return Done(detail="the cell is ready; the robot has to trigger")


async def _step(call: Call[ApiContext]) -> Done:
    cell = call.context.cell
    if cell.state is CellState.HALTED:
        await cell.resume(str(call.peer), step=True)
    else:
        await cell.step()
    return Done(detail="the cell halts after the next slab")


async def _clear(call: Call[ApiContext]) -> Done:
    await call.context.cell.clear(str(call.peer))
    return Done(detail="the cell is ready again; the robot has to trigger")


_TAG = "control"
ENDPOINTS = (
    Endpoint("POST", "/v1/start", "Leave the halted state", _start, Done, _TAG),
    Endpoint("POST", "/v1/stop", "Halt: offer nothing any more", _stop, Done, _TAG),
    Endpoint("POST", "/v1/step", "Go on for one slab, then halt", _step, Done, _TAG),
    Endpoint("POST", "/v1/clear", "Leave the error state, its cause being removed", _clear, Done, _TAG),
)
