"""How are the robot's requests taken?  One after the other, each answered once, and what it brings about is finished.

The robot asks in lock-step.  The same request again gets the same answer; one that cannot be taken is refused before it
does anything.  An answer may leave before the last of its work is done, where the robot cannot act on what it says: the
number of results, while they are written to the ledger.  The turn ends with the work, so the next request, and every
person, waits for that.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

import structlog

from slabcell.cell.cycles import Cycles
from slabcell.cell.desk import JobDesk
from slabcell.cell.leisure import Leisure
from slabcell.cell.reply import Reply, refusal, to_answer
from slabcell.cell.serving import Serving
from slabcell_drivers.robot.protocol import Answer, Request, RequestType, ResultCode

__all__ = ["Requests"]

_log = structlog.stdlib.get_logger("slabcell.cell")


class Requests:
    """Gives each request its turn.  Whoever changes the cell otherwise takes the ``turn`` too."""

    def __init__(
        self,
        serving: Serving,
        desk: JobDesk,
        cycles: Cycles,
        *,
        leisure: Leisure,
        busy_timeout_s: Callable[[], float],
        clock: Callable[[], float],
    ) -> None:
        self.turn = asyncio.Lock()
        self._serving = serving
        self._desk = desk
        self._cycles = cycles
        self._leisure = leisure
        self._busy_timeout_s = busy_timeout_s
        self._clock = clock
        self._since_s: float | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def serving_for_s(self) -> float:
        """How long the present request has been served, in seconds; 0 if there is none."""
        return 0.0 if self._since_s is None else self._clock() - self._since_s

    async def handle(self, request: Request) -> Answer:
        """Answer one request; never raises.  A caller that is cancelled does not undo what was begun."""
        answered: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()
        task = asyncio.create_task(self._take(request, answered), name=f"slabcell-request-{request.type.name}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(partial(_leave_nobody_waiting, answered))
        return await answered

    async def settled(self) -> None:
        """Return when all that was asked until now is done; the ledger then holds it."""
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def end(self, patience_s: float) -> None:
        """Give what is under way so much time, and then give it up: what it had not written yet never was."""
        if self._tasks:
            _, late = await asyncio.wait(self._tasks, timeout=patience_s)
            for task in late:
                task.cancel()

    async def _take(self, request: Request, answered: asyncio.Future[Answer]) -> None:
        try:
            async with asyncio.timeout(self._busy_timeout_s()):
                await self.turn.acquire()
        except TimeoutError:
            _set(answered, self._to_answer(Reply(ResultCode.BUSY, message="Cell is busy. Ask again."), request))
            return
        self._since_s = self._clock()
        try:
            known = self._known(request)
            if known is not None:
                _set(answered, known)
            else:
                await self._serve(request, answered)
        finally:
            self._since_s = None
            self.turn.release()

    def _known(self, request: Request) -> Answer | None:
        """Return what to say to a request that is repeated, or cannot be taken; None to all others."""
        conversation = self._serving.conversation
        known = conversation.recall(request)
        if known is not None:
            _log.info("request repeated", sequence=request.sequence, type=request.type.name)
            return known
        fault = conversation.refuse(request)
        if fault is not None:
            _log.warning("request refused", number=int(fault), type=request.type.name)
            return self._to_answer(refusal(fault), request)
        return None

    async def _serve(self, request: Request, answered: asyncio.Future[Answer]) -> None:
        before, early = self._cycles.present, list[Answer]()

        def say(reply: Reply) -> None:
            early.append(self._to_answer(reply, request))
            _set(answered, early[0])

        with self._leisure.serving(), structlog.contextvars.bound_contextvars(**self._about(request)):
            reply = await self._serving.reply(request, say)
        # What has been said stands, even where the rest then failed: the next request is told of that.
        answer = early[0] if early else self._to_answer(reply, request)
        self._cycles.settle(request, answer, before=before)
        self._serving.conversation.remember(request, answer)
        _set(answered, answer)

    def _about(self, request: Request) -> dict[str, int]:
        """Return what every line that is logged while a request is served is about."""
        job, cycle = self._desk.job, self._cycles.present
        # Every telegram carries the robot's last result; only these two are about it.
        result = request.ack_result_id if request.type in {RequestType.ACK, RequestType.HELLO} else 0
        about = {"job": job.job_id if job else 0, "cycle": cycle.cycle_id if cycle else 0, "result": result}
        return {name: number for name, number in about.items() if number}

    def _to_answer(self, reply: Reply, request: Request) -> Answer:
        known = self._serving.conversation
        return to_answer(reply, request, session=known.session, trigger_sequence=known.trigger_sequence)


def _set(answered: asyncio.Future[Answer], answer: Answer) -> None:
    """Give an answer to who waits for it, if anybody still does."""
    if not answered.done():
        answered.set_result(answer)


def _leave_nobody_waiting(answered: asyncio.Future[Answer], task: asyncio.Task[None]) -> None:
    """End the wait for the answer of a task that has ended without one."""
    if task.cancelled():
        answered.cancel()
    elif (error := task.exception()) is None:
        return
    elif answered.done():
        _log.error("request failed after its answer", task=task.get_name(), exc_info=error)
    else:
        answered.set_exception(error)
