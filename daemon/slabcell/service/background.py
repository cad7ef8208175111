"""What takes longer than a request may?  Work in the background: its state, its progress, and what came of it.

A piece of work is told of by events of kind ``task``, and can be read for a while after its end.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final

import structlog

from slabcell.errors import SlabcellError, TemporaryError

__all__ = ["Background", "BackgroundTask", "TaskState"]

KEPT: Final = 40
UNFINISHED: Final = 4

Json = dict[str, Any]
_log = structlog.get_logger(__name__)


class TaskState(StrEnum):
    """Where a piece of work stands."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(slots=True, eq=False)
class BackgroundTask:
    """One piece of work: ``done`` of ``total`` steps, 0 if that is not known.  Moments are of the monotonic clock."""

    name: str
    kind: str
    title: str
    began_s: float
    state: TaskState = TaskState.RUNNING
    done: int = 0
    total: int = 0
    doing: str = ""
    problem: str = ""
    number: int = 0
    result: Json | None = None
    ended_s: float | None = None
    running: asyncio.Task[None] | None = field(default=None, repr=False)

    @property
    def duration_s(self) -> float:
        """How long it has been running, or ran."""
        return (self.ended_s if self.ended_s is not None else time.monotonic()) - self.began_s


class Background:
    """The work of one daemon.  ``tell`` is told of each step."""

    def __init__(self, tell: Callable[[BackgroundTask], None] = lambda _: None) -> None:
        self._tell = tell
        self._tasks: OrderedDict[str, BackgroundTask] = OrderedDict()

    @property
    def tasks(self) -> tuple[BackgroundTask, ...]:
        """What runs, and the last that ended; the newest first."""
        return tuple(reversed(self._tasks.values()))

    def get(self, name: str) -> BackgroundTask | None:
        """Return one piece of work, or None if it is not known any more."""
        return self._tasks.get(name)

    def start(self, kind: str, title: str, work: Callable[[Callable[[Json], None]], Awaitable[Json]]) -> BackgroundTask:
        """Begin with something; it is given whom to tell its progress, as ``done``, ``total`` and ``doing``.

        Raises TemporaryError where too much is under way.
        """
        unfinished = sum(task.state is TaskState.RUNNING for task in self._tasks.values())
        if unfinished >= UNFINISHED:
            msg = f"{unfinished} tasks are under way already: wait for one of them, or cancel it"
            raise TemporaryError(msg)
        task = BackgroundTask(secrets.token_hex(6), kind, title, time.monotonic())
        self._tasks[task.name] = task
        while len(self._tasks) > KEPT:
            del self._tasks[next(name for name, old in self._tasks.items() if old.state is not TaskState.RUNNING)]

        def progress(said: Json) -> None:
            task.done = int(said.get("done", task.done))
            task.total = int(said.get("total", task.total))
            task.doing = str(said.get("doing", task.doing))
            if task.state is TaskState.RUNNING:
                self._tell(task)

        task.running = asyncio.create_task(self._run(task, work(progress)), name=f"slabcell-{kind}")
        self._tell(task)
        return task

    async def _run(self, task: BackgroundTask, work: Awaitable[Json]) -> None:
        try:
            task.result = await work
            task.state = TaskState.DONE
        except asyncio.CancelledError:
            task.state, task.problem = TaskState.CANCELLED, "was cancelled"
        except SlabcellError as error:
            task.state, task.problem, task.number = TaskState.FAILED, str(error), error.number
        except Exception as error:  # noqa: BLE001 - work that breaks must not end the daemon; the log has the traceback
            task.state, task.problem = TaskState.FAILED, f"{type(error).__name__}: {error}"
            _log.exception("task failed", task=task.name, kind=task.kind)
        task.ended_s = time.monotonic()
        task.doing = ""
        _log.info("task ended", task=task.name, kind=task.kind, state=task.state.value, problem=task.problem)
        self._tell(task)

    async def cancel(self, task: BackgroundTask) -> None:
        """End it, if it has not ended yet."""
        if task.running is not None:
            task.running.cancel()
            await asyncio.gather(task.running, return_exceptions=True)

    async def close(self) -> None:
        """End everything."""
        for task in self._tasks.values():
            await self.cancel(task)
