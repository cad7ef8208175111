"""What does the HMI know of the cell right now?  One picture of it for all pages, kept fresh by the daemon's events.

However many pages are open, the daemon is asked once: its status after an event or every two seconds, its camera
picture when there is a new one and somebody looks.  A page holds nothing but its place in the count of changes.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Final

import structlog

from slabcell.errors import SlabcellError, UnavailableError
from slabcell.hmi.cell_api import CellApi, Json

__all__ = ["CellLink", "Changes", "Picture"]

POLL_S: Final = 2.0
STATUS_PAUSE_S: Final = 0.1
PICTURE_PAUSE_S: Final = 0.4
RETRY_S: Final = 1.0
HANGS_AFTER_S: Final = 3.0
KEPT_CHANGES: Final = 256

_log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """The newest camera picture: what the daemon says of it, overlay included, and the JPEG file."""

    serial: int
    document: Json
    jpeg: bytes
    taken_s: float


@dataclass(frozen=True, slots=True)
class Changes:
    """What changed since a place: the kinds of events, in their order, each once; and the new place."""

    place: int
    kinds: tuple[str, ...]


class CellLink:
    """The HMI's view of one daemon."""

    def __init__(self, api: CellApi) -> None:
        self.api = api
        self.status: Json | None = None
        self.heard_s = 0.0
        """When the daemon gave its last answer, on the monotonic clock."""
        self.problem = "the daemon has not been asked yet"
        self.picture: Picture | None = None
        self.watchers = 0
        """Pages that show the camera picture now."""
        self._changes: deque[tuple[int, str]] = deque(maxlen=KEPT_CHANGES)
        self._place = 0
        self._changed = asyncio.Event()
        self._ask_status = asyncio.Event()
        self._ask_picture = asyncio.Event()
        self._waiting_kinds: dict[str, None] = {}
        self._picture_turn = asyncio.Lock()

    @property
    def up(self) -> bool:
        """Whether the daemon answers."""
        return not self.problem and self.age_s < HANGS_AFTER_S + POLL_S

    @property
    def age_s(self) -> float:
        """How old the status is, in seconds."""
        return time.monotonic() - self.heard_s if self.heard_s else float("inf")

    @property
    def place(self) -> int:
        """The count of changes so far."""
        return self._place

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Keep the picture fresh until the end of the block."""
        works = (self._follow_events(), self._follow_status(), self._follow_picture())
        tasks = [asyncio.create_task(work, name=f"slabcell-hmi-{work.__name__}") for work in works]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    # Changes

    def tell(self, *kinds: str) -> None:
        """Count changes, and wake the pages."""
        for kind in kinds:
            self._place += 1
            self._changes.append((self._place, kind))
        if kinds:
            self._changed.set()
            self._changed = asyncio.Event()

    async def changes(self, place: int, timeout_s: float) -> Changes:
        """Return what changed since a place, at once or when it does; nothing after the time."""
        if place >= self._place:
            with suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await self._changed.wait()
        if self._changes and place + 1 < self._changes[0][0]:
            return Changes(self._place, ("reset",))
        return Changes(self._place, tuple(dict.fromkeys(kind for number, kind in self._changes if number > place)))

    # Status

    async def refresh(self) -> Json:
        """Return the status as it is now.  Raises SlabcellError."""
        status, before = await self.api.get("/v1/status"), self.status
        if before is not None and before["recipe"] != status["recipe"]:  # which no event of the daemon tells
            self.tell("state")
        self.status, self.heard_s, self.problem = status, time.monotonic(), ""
        return status

    async def _follow_status(self) -> None:
        while True:
            was_up = self.up
            kinds, self._waiting_kinds = tuple(self._waiting_kinds), {}
            try:
                async with asyncio.timeout(HANGS_AFTER_S):
                    await self.refresh()
            except (SlabcellError, TimeoutError) as error:
                self.problem = str(error) or f"the daemon does not answer within {HANGS_AFTER_S:g} s"
            if self.up != was_up:
                _log.info("daemon reached" if self.up else "daemon not reached", problem=self.problem)
                kinds = ("reset",) if self.up else ("lost",)
            self.tell(*kinds)
            await asyncio.sleep(STATUS_PAUSE_S)
            with suppress(TimeoutError):
                async with asyncio.timeout(POLL_S):
                    await self._ask_status.wait()
            self._ask_status.clear()

    async def _follow_events(self) -> None:
        while True:
            try:
                async for event in self.api.events():
                    if event is not None:
                        self._waiting_kinds[event.kind] = None
                        self._ask_status.set()
                        if event.kind in {"frame", "located", "cycle"}:
                            self._ask_picture.set()
            except (UnavailableError, SlabcellError) as error:
                self._ask_status.set()
                if self.up:
                    _log.info("events of the daemon ended", problem=str(error))
            await asyncio.sleep(RETRY_S)

    # Picture

    async def _follow_picture(self) -> None:
        while True:
            await self._ask_picture.wait()
            self._ask_picture.clear()
            if self.watchers:
                await self.newest_picture()
            await asyncio.sleep(PICTURE_PAUSE_S)

    async def newest_picture(self) -> Picture | None:
        """Return the newest picture, asked for once however many want it; None if there is none, or no daemon."""
        async with self._picture_turn:
            try:
                document = await self.api.get("/v1/frames/latest")
                known = self.picture
                jpeg = known.jpeg if known and known.document["frame"] == document["frame"] else b""
                if not jpeg:
                    answer = await self.api.fetch("/v1/frames/latest.jpg")
                    if answer.etag.strip('"') != document["frame"]:  # a newer one came in between
                        self._ask_picture.set()
                        return known
                    jpeg = answer.content
                elif known and known.document["overlay"] == document["overlay"]:
                    return known
            except SlabcellError:
                return self.picture
            taken_s = time.monotonic() - float(document["age_s"])
            self.picture = Picture((known.serial if known else 0) + 1, document, jpeg, taken_s)
            self.tell("picture")
            return self.picture
