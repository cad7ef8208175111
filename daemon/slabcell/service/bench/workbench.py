"""Who may use the bench, and when?  A short queue, deadlines, and a halt of the bench while the cell works."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import structlog

from slabcell.cell.events import Event, StateChanged
from slabcell.cell.executor import end_executor
from slabcell.cell.states import CellState
from slabcell.errors import TemporaryError
from slabcell.service.bench.process import BenchError, BenchProcess
from slabcell.service.bench.wire import Json, Message

__all__ = ["Workbench"]

MAX_WAITING: Final = 6
IDLE_S: Final = 120.0
_AWAY: Final = frozenset({CellState.ACQUIRING, CellState.LOCATING, CellState.VERIFYING})

_log = structlog.get_logger(__name__)


def _ignore(_: Json) -> None:
    return


class Workbench:
    """The bench of one cell; used in the event loop."""

    def __init__(self, *, idle_s: float = IDLE_S) -> None:
        self._process = BenchProcess()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="slabcell-bench")
        self._waiting = 0
        self._idle_s = idle_s
        self._idle: asyncio.TimerHandle | None = None
        self._closed = False

    @property
    def process(self) -> BenchProcess:
        """The child."""
        return self._process

    def see(self, event: Event) -> None:
        """Take an event of the cell: while it looks and computes, the bench stands still."""
        if isinstance(event, StateChanged):
            if event.after in _AWAY:
                self._process.pause()
            else:
                self._process.resume()

    async def run(
        self,
        task: str,
        arguments: Json,
        blobs: Sequence[bytes | memoryview] = (),
        *,
        timeout_s: float,
        progress: Callable[[Json], None] = _ignore,
    ) -> Message:
        """Return what came of a task, one after the other.  A caller that is cancelled ends its task.

        Raises TemporaryError when too many wait, BenchError, and what the task itself raises.
        """
        if self._closed or self._waiting >= MAX_WAITING:
            what = "is ending" if self._closed else f"has {self._waiting} tasks already"
            msg = f"the bench {what}: ask again later"
            raise TemporaryError(msg)
        if self._idle is not None:
            self._idle.cancel()
        loop = asyncio.get_running_loop()
        begun, dropped = False, False

        def tell(content: Json) -> None:
            loop.call_soon_threadsafe(progress, content)

        def work() -> Message:
            nonlocal begun
            if dropped or self._closed:
                msg = f"{task} was cancelled"
                raise BenchError(msg)
            begun = True
            return self._process.ask(task, arguments, blobs, timeout_s=timeout_s, progress=tell)

        self._waiting += 1
        running = loop.run_in_executor(self._thread, work)
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            dropped = True
            if begun and not running.done():
                await asyncio.to_thread(self._process.kill)
            await asyncio.gather(running, return_exceptions=True)
            raise
        finally:
            self._waiting -= 1
            if self._waiting == 0 and not self._closed:
                self._idle = loop.call_later(self._idle_s, self._rest)

    def _rest(self) -> None:
        """End a child that nobody has needed for a while."""
        if self._waiting == 0:
            _log.info("bench idle, ended", pid=self._process.pid)
            self._thread.submit(self._process.kill)

    async def close(self) -> None:
        """End what runs, and the child; may be called twice."""
        if self._closed:
            return
        self._closed = True
        if self._idle is not None:
            self._idle.cancel()
        await asyncio.to_thread(self._process.kill)
        await end_executor(self._thread)
        await asyncio.to_thread(self._process.kill)  # one that was being started meanwhile
