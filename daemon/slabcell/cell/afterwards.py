"""What need not be done while the robot waits?  What people read: log lines, and what watchers are told.

It is done a moment later, in the order in which it was given, so that no line tells of something before its cause.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextvars import Context, copy_context

import structlog

__all__ = ["Afterwards", "at_once"]

MOMENT_S = 0.001
"""Long enough for the vision's thread to have begun, or for an answer to have left; no person sees the difference."""

_log = structlog.stdlib.get_logger("slabcell.cell")


def at_once(work: Callable[[], None]) -> None:
    """Do it now: for who has nobody waiting."""
    work()


class Afterwards:
    """Belongs to one event loop.  Without one that runs, everything is done at once."""

    def __init__(self) -> None:
        self._left: deque[tuple[Context, Callable[[], None]]] = deque()
        self._due: asyncio.TimerHandle | None = None

    def do(self, work: Callable[[], None]) -> None:
        """Have ``work`` done soon, in the present context.  What it raises is logged."""
        self._left.append((copy_context(), work))
        if self._due is None:
            try:
                self._due = asyncio.get_running_loop().call_later(MOMENT_S, self.catch_up)
            except RuntimeError:
                self.catch_up()

    def catch_up(self) -> None:
        """Do now what is left; what is given meanwhile too."""
        if self._due is not None:
            self._due.cancel()
        try:
            while self._left:
                context, work = self._left.popleft()
                try:
                    context.run(work)
                except Exception:  # noqa: BLE001 - what people read must not stop the cell
                    _log.exception("telling failed", what=repr(work))
        finally:
            self._due = None
