"""How do events reach a client that stays?  Server-sent events, resumable, to a limited number of clients.

A client that does not read is dropped after a time; what it holds meanwhile is one write buffer of the kernel and one
of the server.  Source: WHATWG HTML, section "Server-sent events".
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from typing import Final

import structlog
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from slabcell.service.api.ring import EventRing, Item

__all__ = ["EventStream", "StreamSeats"]

KEEP_ALIVE_S: Final = 10.0
STUCK_S: Final = 20.0
RETRY_MS: Final = 1000

_log = structlog.get_logger(__name__)


class StreamSeats:
    """How many clients may listen at once, and how many do."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.taken = 0
        self.dropped = 0
        """Clients that were dropped because they did not read."""

    @property
    def free(self) -> bool:
        """Whether one more may come."""
        return self.taken < self.limit


class EventStream(Response):
    """The stream to one client: what follows event ``after``, of the kinds it wants, until it goes.

    What has happened is told after a ``pause``: who looks on must take no time from the robot.
    """

    media_type = "text/event-stream"

    def __init__(
        self,
        ring: EventRing,
        seats: StreamSeats,
        *,
        after: int,
        gap: bool,
        kinds: Collection[str],
        pause: Callable[[], Awaitable[None]],
        stuck_s: float = STUCK_S,
        keep_alive_s: float = KEEP_ALIVE_S,
    ) -> None:
        super().__init__(headers={"cache-control": "no-store"})
        del self.headers["content-length"]  # it has no end
        self._ring = ring
        self._seats = seats
        self._place = after
        self._gap = gap
        self._kinds = frozenset(kinds)
        self._pause = pause
        self._stuck_s = stuck_s
        self._keep_alive_s = keep_alive_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve the client until it goes, does not read, or the daemon ends."""
        self._seats.taken += 1
        sending = asyncio.create_task(self._send(send), name="slabcell-events")
        leaving = asyncio.create_task(_gone(receive), name="slabcell-events-gone")
        try:
            await asyncio.wait({sending, leaving}, return_when=asyncio.FIRST_COMPLETED)
            if sending.done() and isinstance(sending.exception(), TimeoutError):
                self._seats.dropped += 1
                _log.warning("event client dropped", reason=f"it read nothing for {self._stuck_s:g} s")
                scope["state"]["abort"]()  # a close would wait for it to read
        finally:
            self._seats.taken -= 1
            for task in (sending, leaving):
                task.cancel()
            await asyncio.gather(sending, leaving, return_exceptions=True)

    async def _send(self, send: Send) -> None:
        await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
        await self._write(send, f"retry: {RETRY_MS}\n\n")
        while not self._ring.closed:
            page = self._ring.after(self._place)
            gap, self._gap = self._gap or page.gap, False
            text = ""
            if gap:
                before = page.items[0].number - 1 if page.items else self._place
                text = _line(self._ring, Item(before, "reset", "{}"))
            for item in page.items:
                self._place = item.number
                if not self._kinds or item.kind in self._kinds:
                    text += _line(self._ring, item)
            if text:
                await self._write(send, text)
            if not page.items and not await self._ring.more(self._place, self._keep_alive_s):
                await self._write(send, ":\n\n")
            await self._pause()
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _write(self, send: Send, text: str) -> None:
        async with asyncio.timeout(self._stuck_s):
            await send({"type": "http.response.body", "body": text.encode(), "more_body": True})


def _line(ring: EventRing, item: Item) -> str:
    return f"id: {ring.id_of(item.number)}\nevent: {item.kind}\ndata: {item.data}\n\n"


async def _gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
