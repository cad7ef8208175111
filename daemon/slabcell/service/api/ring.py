"""What has happened lately?  The last events with ascending ids, for clients that read at their own pace.

Memory is bounded by the number of events, not by the number or the speed of clients: a client holds nothing but its
place.  One that fell behind, or comes from before a restart, is told to read the state anew.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

__all__ = ["EventRing", "Item", "Page"]

KEPT = 1000
MAX_PAGE = 100


@dataclass(slots=True, eq=False)
class Item:
    """One event: its number, counted from 1 since the start, its kind, and its content, or what makes it."""

    number: int
    kind: str
    content: str | Callable[[], str]

    @property
    def data(self) -> str:
        """The content as one line of JSON; made when it is read first, which it often never is."""
        if not isinstance(self.content, str):
            self.content = self.content()
        return self.content


@dataclass(frozen=True, slots=True)
class Page:
    """Events that follow a place, at most so many at once; ``gap`` if some before them are no longer known."""

    items: tuple[Item, ...]
    gap: bool


class EventRing:
    """The last events of one run of the daemon; ``epoch`` tells runs apart and is part of every id."""

    def __init__(self, epoch: str, *, kept: int = KEPT) -> None:
        self.epoch = epoch
        self._items: deque[Item] = deque(maxlen=kept)
        self._last = 0
        self._more = asyncio.Event()
        self._closed = False

    @property
    def last(self) -> int:
        """The number of the newest event."""
        return self._last

    @property
    def closed(self) -> bool:
        """Whether the daemon ends: nothing follows any more."""
        return self._closed

    def add(self, kind: str, content: str | Callable[[], str]) -> None:
        """Add an event, and wake who waits; called in the event loop.

        ``content`` is one line of JSON, or what makes it of things that do not change.
        """
        self._last += 1
        self._items.append(Item(self._last, kind, content))
        self._wake()

    def close(self) -> None:
        """Say that nothing follows."""
        self._closed = True
        self._wake()

    def _wake(self) -> None:
        self._more.set()
        self._more = asyncio.Event()

    def id_of(self, number: int) -> str:
        """Return the id of an event as clients know it."""
        return f"{self.epoch}-{number}"

    def place_of(self, last_event_id: str) -> int | None:
        """Return the number behind an id that a client names, or None if it is of another run, or none at all."""
        epoch, _, number = last_event_id.rpartition("-")
        if epoch != self.epoch or not number.isdecimal() or len(number) > 18:
            return None
        return int(number) if int(number) <= self._last else None

    def after(self, number: int) -> Page:
        """Return what follows an event, at most a page of it."""
        oldest = self._items[0].number if self._items else self._last + 1
        start = max(0, number + 1 - oldest)
        return Page(tuple(islice(self._items, start, start + MAX_PAGE)), gap=number + 1 < oldest)

    async def more(self, number: int, timeout_s: float) -> bool:
        """Wait until something follows an event, or nothing ever will; return False after the time."""
        if self._last > number or self._closed:
            return True
        try:
            async with asyncio.timeout(timeout_s):
                await self._more.wait()
        except TimeoutError:
            return False
        return True
