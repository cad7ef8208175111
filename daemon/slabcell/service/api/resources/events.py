"""What happens now?  The stream of events, from now on or from where a client left off."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from starlette.responses import Response

from slabcell.service.api.context import ApiContext
from slabcell.service.api.endpoint import Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.stream import EventStream
from slabcell.service.event_feed import KINDS

__all__ = ["ENDPOINTS"]


class EventsQuery(Query):
    """From where, and what."""

    after: Annotated[str, Field(max_length=64)] | None = Field(
        default=None, description="id of the last event that is known; the header Last-Event-ID counts more"
    )
    kinds: Annotated[str, Field(max_length=200)] = Field(
        default="", description=f"only these, parted by commas; there are {', '.join(KINDS)}"
    )


async def _events(call: Call[ApiContext]) -> Response:
    ring, seats = call.context.ring, call.context.seats
    kinds = [kind for kind in call.query.kinds.split(",") if kind]
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise ProblemError(422, f"kinds: {unknown[0]!r:.40} is no kind of event; there are {', '.join(KINDS)}")
    if not seats.free:
        raise ProblemError(503, f"{seats.limit} clients listen already, more are not served")
    last = call.request.headers.get("last-event-id") or call.query.after
    place = ring.place_of(last) if last else ring.last
    return EventStream(
        ring,
        seats,
        after=ring.last if place is None else place,
        gap=place is None,
        kinds={*kinds, "reset"} if kinds else (),
        pause=call.context.pause,
    )


ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/events", "Events as they happen, as server-sent events", _events, "text/event-stream", "events"),
        query=EventsQuery,
        problems=(503,),
    ),
)
