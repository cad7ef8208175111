"""How does a library that blocks live beside asyncio?  In one thread of its own, behind awaitable calls.

The caller's wait may end before the call does: the thread then finishes the call by itself, and the next call waits for
that.  Nothing else ever touches the library's objects.
"""

import asyncio
import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["Worker"]

T = TypeVar("T")


class Worker:
    """One thread; it begins with the first call and ends with `close`."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._thread: threading.Thread | None = None
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()

    async def call(self, function: Callable[[], T]) -> T:
        """Run a function on the thread and return what it returns, or raise what it raises."""
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()

        def job() -> None:
            result: T | None = None
            error: BaseException | None = None
            try:
                result = function()
            except BaseException as raised:  # noqa: BLE001 - it is raised again where it is awaited
                error = raised
            with contextlib.suppress(RuntimeError):  # the loop has ended: nobody waits any more
                loop.call_soon_threadsafe(_settle, future, result, error)

        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()
        self._jobs.put(job)
        return await future

    async def close(self, timeout_s: float) -> bool:
        """End the thread after the call it is in; False if that takes longer than the time given."""
        thread, self._thread = self._thread, None
        if thread is None:
            return True
        self._jobs.put(None)
        self._jobs = queue.SimpleQueue()
        await asyncio.to_thread(thread.join, timeout_s)
        return not thread.is_alive()

    def _run(self) -> None:
        jobs = self._jobs
        while (job := jobs.get()) is not None:
            job()


def _settle(future: asyncio.Future[Any], result: object, error: BaseException | None) -> None:
    if future.done():
        return  # the caller has gone
    if error is not None:
        future.set_exception(error)
    else:
        future.set_result(result)
