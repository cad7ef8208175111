"""Does the robot wait just now?  What can be done later asks here first, so that it takes no time from a request.

Threads share one interpreter and few processors: whatever computes while a request is served makes the robot wait.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress

__all__ = ["Leisure"]

QUIET_S = 0.02
"""Requests often come in a row (TRIGGER, NEXT): only when none has come for so long is there time for other things."""


class Leisure:
    """Knows when requests are served.  `serving` and `pause` belong to the event loop, `wait` to threads."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._served = threading.Event()
        self._served.set()
        self._since_s = clock() - QUIET_S
        self._over = False
        self._ended = asyncio.Event()

    @contextmanager
    def serving(self) -> Generator[None]:
        """Serve one request within; requests are served one after the other."""
        self._served.clear()
        try:
            yield
        finally:
            self._since_s = self._clock()
            self._served.set()
            self._ended.set()
            self._ended = asyncio.Event()

    def end(self) -> None:
        """Make nobody wait any more: what is left has to be done now."""
        self._over = True
        self._served.set()
        self._ended.set()

    async def pause(self, patience_s: float) -> None:
        """Return when no request is served and none was a moment ago, at the latest after ``patience_s``."""
        with suppress(TimeoutError):
            async with asyncio.timeout(patience_s):
                while not self._over and (left_s := self._quiet_in_s()) > 0.0:
                    if self._served.is_set():
                        await asyncio.sleep(left_s)
                    else:
                        await self._ended.wait()

    def _quiet_in_s(self) -> float:
        """Return how long there has to be no request from now on."""
        return self._since_s + QUIET_S - self._clock() if self._served.is_set() else QUIET_S

    def wait(self, patience_s: float, *, urgent: Callable[[], bool] = lambda: False) -> None:
        """Return when no request is served and none was a moment ago.

        At the latest after ``patience_s``, or soon after it has become ``urgent``.
        """
        deadline_s = self._clock() + patience_s
        while not (self._over or urgent()) and self._clock() < deadline_s:
            quiet = self._clock() - self._since_s >= QUIET_S
            if self._served.wait(QUIET_S) and quiet:
                return
            if not quiet:
                time.sleep(QUIET_S / 4)
