"""Which alarms stand, which came, and what does a person do about them?"""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from slabcell.catalogue import Fault, entry
from slabcell.cell.alarms import MAX_SHELVED_S
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import AlarmHistoryDocument, AlarmsDocument, Done, PastAlarmDocument
from slabcell.service.api.endpoint import Body, Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.views import alarm_view

__all__ = ["ENDPOINTS"]

MAX_PAGE: Final = 200
FIRST: Final = 1 << 60


class AlarmsQuery(Query):
    """Which alarms."""

    shelved: bool = Field(default=False, description="show shelved alarms too")


class AlarmHistoryQuery(Query):
    """Which page."""

    limit: Annotated[int, Field(ge=1, le=MAX_PAGE)] = Field(default=50, description="at most so many")
    before: Annotated[int, Field(ge=1)] = Field(default=FIRST, description="only alarms with an id below this")


class ShelveBody(Body):
    """For how long an alarm is not shown."""

    duration_s: Annotated[float, Field(gt=0, le=MAX_SHELVED_S)] = Field(description="seconds, one shift at most")


async def _list(call: Call[ApiContext]) -> AlarmsDocument:
    alarms = call.context.cell.alarms
    shown = alarms.shown
    hidden = [alarm for alarm in alarms.standing if alarm not in shown] if call.query.shelved else []
    return AlarmsDocument(alarms=[alarm_view(alarms, alarm) for alarm in (*shown, *hidden)])


async def _history(call: Call[ApiContext]) -> AlarmHistoryDocument:
    limit, before = int(call.query.limit), int(call.query.before)
    rows = await call.context.history.read(lambda file: file.alarms(before=before, limit=limit + 1))
    return AlarmHistoryDocument(
        alarms=[
            PastAlarmDocument(
                id=row.id,
                number=row.number,
                title=entry(row.number).title,
                detail=row.detail,
                came=row.came_utc,
                went=row.went_utc,
                why=row.why,
            )
            for row in rows[:limit]
        ],
        before=rows[limit - 1].id if len(rows) > limit else None,
    )


def _fault(call: Call[ApiContext]) -> Fault:
    number = call.number("number")
    if number not in {int(fault) for fault in Fault}:
        raise ProblemError(404, f"the error catalogue has no number {number}")
    if call.context.cell.alarms.has(Fault(number)) is None:
        raise ProblemError(404, f"alarm {number} does not stand")
    return Fault(number)


async def _acknowledge(call: Call[ApiContext]) -> Done:
    fault = _fault(call)
    await call.context.cell.acknowledge(fault, str(call.peer))
    stands = call.context.cell.alarms.has(fault) is not None
    after = "it stands on until its cause is gone" if stands else "it is cleared"
    return Done(detail=f"alarm {int(fault)} is acknowledged; {after}")


async def _shelve(call: Call[ApiContext]) -> Done:
    fault = _fault(call)
    call.context.cell.alarms.shelve(fault, call.body.duration_s)
    return Done(detail=f"alarm {int(fault)} is not shown for {call.body.duration_s:g} s")


async def _unshelve(call: Call[ApiContext]) -> Done:
    fault = _fault(call)
    call.context.cell.alarms.unshelve(fault)
    return Done(detail=f"alarm {int(fault)} is shown again")


_TAG = "alarms"
ENDPOINTS = (
    Endpoint("GET", "/v1/alarms", "The alarms that stand", _list, AlarmsDocument, _TAG, query=AlarmsQuery),
    Endpoint(
        *("GET", "/v1/alarms/history", "Alarms that came, the newest first", _history, AlarmHistoryDocument, _TAG),
        query=AlarmHistoryQuery,
    ),
    Endpoint(
        *("POST", "/v1/alarms/{number}/acknowledge", "Say that an alarm is seen, or dealt with", _acknowledge),
        *(Done, _TAG),
        problems=(404, 409),
    ),
    Endpoint(
        *("POST", "/v1/alarms/{number}/shelve", "Do not show an alarm for a while", _shelve, Done, _TAG),
        body=ShelveBody,
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/alarms/{number}/unshelve", "Show a shelved alarm again", _unshelve, Done, _TAG),
        problems=(404,),
    ),
)
