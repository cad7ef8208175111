"""How is the cell?  Its state, links, job, last cycle and most urgent alarm, in one answer."""

from __future__ import annotations

import os
import time

from slabcell import __version__
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import CycleDocument, JobDocument, StatusDocument
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.resources.jobs import present_job
from slabcell.service.api.views import alarm_view, cycle_view, link_view, opc40100, packml, robot_view
from slabcell_drivers.robot.eki.schema import PROTOCOL_VERSION

__all__ = ["ENDPOINTS"]


async def _status(call: Call[ApiContext]) -> StatusDocument:
    context = call.context
    job = await present_job(context)
    return status_of(context, job)


def status_of(context: ApiContext, job: JobDocument | None) -> StatusDocument:
    """Return the status at this moment of the event loop."""
    cell = context.cell
    shown = cell.alarms.shown
    return StatusDocument(
        name=context.name,
        version=__version__,
        protocol=PROTOCOL_VERSION,
        pid=os.getpid(),
        uptime_s=round(time.monotonic() - context.started_s, 3),
        state=cell.state.value,
        opc40100=opc40100(cell.state),
        packml=packml(cell.state, cell.held, cell.suspended),
        held=cell.held.value if cell.held else None,
        suspended=cell.suspended.value if cell.suspended else None,
        stepping=cell.stepping,
        recipe=cell.recipe.name,
        template_sha256=cell.recipe.template.sha256,
        calibration_created=_created(context),
        links=[link_view(context.links, link) for link in context.links.all],
        robot=robot_view(context.robot),
        refused_peers=context.robot.refused_peers,
        job=job,
        cycle=_last_cycle(context),
        alarms=len(shown),
        highest_alarm=alarm_view(cell.alarms, shown[0]) if shown else None,
        event=context.ring.id_of(context.ring.last),
        pending_reload=list(context.pending_reload),
    )


def _created(context: ApiContext) -> str | None:
    calibration = context.cell.calibration
    created = None if calibration is None else calibration.diagnostics.get("created")
    return created if isinstance(created, str) else None


def _last_cycle(context: ApiContext) -> CycleDocument | None:
    records = context.cell.cycles
    if not records:
        return None
    return cycle_view(records[-1], ended=records[-1] is not context.cell.present_cycle)


ENDPOINTS = (Endpoint("GET", "/v1/status", "How the cell is", _status, StatusDocument, "status"),)
