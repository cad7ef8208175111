"""How does an open page hear what changes?  Over one WebSocket: a beat every second, kinds of changes, camera pictures.

A picture is sent only to a page that has asked for one since it got the last (its credit is one), and then it is the
newest: nothing is queued for anybody.  So many pages may be connected at once, and one that does not read is dropped.

To the page: JSON texts ``{"beat": ..., "kinds": [...]}`` and ``{"picture": {...}}``, after which the JPEG file comes as
one binary message.  From the page: the text ``picture``, which is its credit.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

import structlog
from starlette.websockets import WebSocket, WebSocketDisconnect

from slabcell.hmi.context import Hmi
from slabcell.hmi.guard import cookie_name, is_known_host, is_own_origin
from slabcell.hmi.link import Picture
from slabcell.hmi.security.sessions import Session

__all__ = ["LOGIN_ENDED", "live_endpoint"]

BEAT_S: Final = 1.0
PAUSE_S: Final = 0.1
"""Changes of so long are told together."""
STUCK_S: Final = 20.0
LOGIN_ENDED: Final = "login-ended"
"""The kind of change that wakes every open page, whose login is looked at before anything more is sent."""
POLICY_VIOLATION: Final = 1008
TRY_LATER: Final = 1013
GOING_AWAY: Final = 1001

_log = structlog.get_logger(__name__)


def live_endpoint(hmi: Hmi) -> Callable[[WebSocket], Awaitable[None]]:
    """Return the endpoint."""

    async def serve(socket: WebSocket) -> None:
        token = socket.cookies.get(cookie_name(hmi), "")
        session = await hmi.sessions.find(token) if token else None
        if session is None or not is_known_host(hmi, socket.headers) or not is_own_origin(hmi, socket.headers):
            await socket.close(POLICY_VIOLATION)  # before accepting: the browser sees 403
            return
        if hmi.live >= hmi.options.live_clients:
            await socket.accept()
            await socket.close(TRY_LATER, "too many pages are open")
            return
        hmi.live += 1
        try:
            await socket.accept()
            await _Seat(hmi, socket, session).serve()
        finally:
            hmi.live -= 1

    return serve


class _Seat:
    """One connected page."""

    def __init__(self, hmi: Hmi, socket: WebSocket, session: Session) -> None:
        self._hmi, self._link, self._socket, self._session = hmi, hmi.link, socket, session
        self._words = hmi.words_of(socket.cookies, "base")
        self._wants_picture = False
        self._watches = False
        self._sent: Picture | None = None
        self._wake = asyncio.Event()

    async def serve(self) -> None:
        """Serve the page until it goes, its login ends, it does not read, or the HMI ends."""
        works = (self._send(), self._receive(), self._hmi.stopping.wait())
        tasks = [asyncio.create_task(work, name="slabcell-hmi-live") for work in works]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            failure = None if tasks[0].cancelled() or not tasks[0].done() else tasks[0].exception()
            if isinstance(failure, TimeoutError):
                _log.warning("page dropped", reason=f"it read nothing for {STUCK_S:g} s", user=self._session.user.name)
        finally:
            if self._watches:
                self._link.watchers -= 1
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with suppress(RuntimeError, WebSocketDisconnect, TimeoutError, OSError):
                async with asyncio.timeout(1.0):
                    await self._socket.close(GOING_AWAY if self._hmi.stopping.is_set() else POLICY_VIOLATION)

    async def _receive(self) -> None:
        with suppress(WebSocketDisconnect):
            while True:
                if await self._socket.receive_text() != "picture":
                    return
                if not self._watches:
                    self._watches = True
                    self._link.watchers += 1
                    await self._link.newest_picture()
                self._wants_picture = True
                self._wake.set()

    async def _send(self) -> None:
        place = self._link.place
        kinds: tuple[str, ...] = ()
        while True:
            await self._tell({"beat": self._link.up, "age_s": _age(self._link.age_s), "kinds": kinds})
            picture = self._link.picture
            if self._wants_picture and picture is not None and picture is not self._sent:
                await self._show(picture)
            await asyncio.sleep(PAUSE_S)
            place, kinds = await self._next(place)
            if not await self._hmi.sessions.alive(self._session):
                return

    async def _next(self, place: int) -> tuple[int, tuple[str, ...]]:
        """Return the new place and what changed, when it did, a picture was asked for, or a beat is due."""
        changed = asyncio.create_task(self._link.changes(place, BEAT_S), name="slabcell-hmi-changes")
        waked = asyncio.create_task(self._wake.wait(), name="slabcell-hmi-wake")
        try:
            await asyncio.wait({changed, waked}, return_when=asyncio.FIRST_COMPLETED)
            self._wake.clear()
            changes = changed.result() if changed.done() else None
            return (changes.place, changes.kinds) if changes else (place, ())
        finally:
            for task in (changed, waked):
                task.cancel()
            await asyncio.gather(changed, waked, return_exceptions=True)

    async def _show(self, picture: Picture) -> None:
        self._sent = picture
        self._wants_picture = False
        age_s = time.monotonic() - picture.taken_s
        document = self._words.said_in(picture.document)
        await self._tell({"picture": {**document, "age_s": round(age_s, 3)}})
        async with asyncio.timeout(STUCK_S):
            await self._socket.send_bytes(picture.jpeg)

    async def _tell(self, content: dict[str, object]) -> None:
        async with asyncio.timeout(STUCK_S):
            await self._socket.send_text(json.dumps(content, allow_nan=False))


def _age(age_s: float) -> float | None:
    return round(age_s, 2) if age_s != float("inf") else None
