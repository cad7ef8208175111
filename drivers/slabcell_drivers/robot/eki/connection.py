"""How is one robot served over one byte stream?  Requests in, answers out, in lock-step, everything bounded.

A reader task cuts and decodes telegrams; heartbeats it answers at once, everything else goes through a short queue to
the handler, one request at a time.  The connection is responsible for bytes and liveness, *not* for what a request
means: a repeated request is handed on like the first.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable

import structlog

from slabcell_drivers.robot.eki.codec import (
    HEARTBEAT,
    InvalidTelegramError,
    TelegramError,
    decode_request,
    encode_answer,
)
from slabcell_drivers.robot.eki.framing import Framer, FramingError
from slabcell_drivers.robot.eki.schema import ROBOT
from slabcell_drivers.robot.link_events import Direction, EndReason, TelegramHook
from slabcell_drivers.robot.message import printable
from slabcell_drivers.robot.protocol import Answer, Request, RequestType, ResultCode

__all__ = ["Connection"]

MAX_QUEUED_REQUESTS = 8
MAX_BAD_IN_A_ROW = 16
READ_BYTES = 16 * 1024
WRITE_TIMEOUT_S = 2.0

_log = structlog.get_logger(__name__)


class Connection:
    """Serves one robot until the connection ends; `run` returns why."""

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        answer: Callable[[Request], Awaitable[bytes]],
        *,
        heartbeat_timeout_s: float,
        on_telegram: TelegramHook | None = None,
    ) -> None:
        self._reader, self._writer = reader, writer
        self._answer = answer
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._on_telegram = on_telegram
        self._queue: asyncio.Queue[Request] = asyncio.Queue(MAX_QUEUED_REQUESTS)
        self._heartbeat_due_s: float | None = None
        self._bad_in_a_row = 0
        self._working: asyncio.Task[None] | None = None
        self._asking = False
        self._end: asyncio.Future[EndReason] = asyncio.get_running_loop().create_future()
        self.last_received_s = time.monotonic()

    def end(self, reason: EndReason) -> None:
        """Ask the connection to end; the first reason counts."""
        if not self._end.done():
            self._end.set_result(reason)

    async def run(self) -> EndReason:
        """Serve the robot; returns why the connection ended, with the socket closed.

        Then only the request that was under way is left: `settle` waits for it.
        """
        reading, working = asyncio.create_task(self._read()), asyncio.create_task(self._work())
        self._working = working
        tasks = [reading, working]
        try:
            await asyncio.wait([*tasks, self._end], return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                if task.done() and (error := task.exception()) is not None:
                    # For example a hook that raises: the link must outlive it.
                    _log.error("eki.connection_failed", exc_info=error)
                    self.end(EndReason.FAILED)
            return self._end.result()
        finally:
            self.end(EndReason.STOPPED)  # unless it has ended: who asks goes by that
            ended = [reading] if self._asking else tasks
            for task in ended:
                task.cancel()
            await asyncio.gather(*ended, return_exceptions=True)
            await self._close()

    async def settle(self) -> None:
        """Wait until the request that was under way is finished; nobody hears its answer any more."""
        if self._working is not None:
            await asyncio.gather(self._working, return_exceptions=True)

    async def _close(self) -> None:
        self._writer.transport.abort() if self._write_backlog() else self._writer.close()
        try:
            await asyncio.wait_for(self._writer.wait_closed(), WRITE_TIMEOUT_S)
        except (OSError, TimeoutError) as error:
            self._writer.transport.abort()
            _log.debug("eki.close", error=repr(error))

    def _write_backlog(self) -> int:
        return self._writer.transport.get_write_buffer_size()

    # ------------------------------------------------------------------------------------------------------- reading

    async def _read(self) -> None:
        framer = Framer(ROBOT.root)
        while not self._end.done():
            try:
                async with asyncio.timeout_at(self._heartbeat_due_s):
                    data = await self._reader.read(READ_BYTES)
            except TimeoutError:
                # Both a silent robot and a TCP keep-alive that failed arrive here; either way nobody is there.
                self.end(EndReason.SILENT)
                return
            except OSError as error:
                _log.info("eki.broken", error=repr(error))
                self.end(EndReason.BROKEN)
                return
            if not data:
                self.end(EndReason.PEER_CLOSED)
                return
            self.last_received_s = time.monotonic()
            if self._heartbeat_due_s is not None:
                self._heartbeat_due_s = asyncio.get_running_loop().time() + self._heartbeat_timeout_s
            for event in framer.feed(data):
                await self._receive(event)

    async def _receive(self, event: bytes | FramingError) -> None:
        try:
            if isinstance(event, FramingError):
                raise event
            self._record(Direction.RECEIVED, event)
            request = decode_request(event)
        except InvalidTelegramError as error:
            self._count_bad(error)
            refusal = Answer(
                error.session, error.sequence, error.sequence, ResultCode.BAD_REQUEST, message=printable(str(error))
            )
            await self._send(encode_answer(refusal))
        except (FramingError, TelegramError) as error:
            self._count_bad(error)
        else:
            self._bad_in_a_row = 0
            await self._dispatch(request)

    async def _dispatch(self, request: Request) -> None:
        if request.type is RequestType.HEARTBEAT:
            self._heartbeat_due_s = asyncio.get_running_loop().time() + self._heartbeat_timeout_s
            await self._send(HEARTBEAT)
            return
        try:
            self._queue.put_nowait(request)
        except asyncio.QueueFull:
            self.end(EndReason.FLOODED)

    def _count_bad(self, error: Exception) -> None:
        self._bad_in_a_row += 1
        _log.warning("eki.bad_telegram", error=str(error), in_a_row=self._bad_in_a_row)
        if self._bad_in_a_row >= MAX_BAD_IN_A_ROW:
            self.end(EndReason.GARBAGE)

    # ------------------------------------------------------------------------------------------------------ answering

    async def _work(self) -> None:
        while not self._end.done():
            request = await self._queue.get()
            self._asking = True
            answer = await self._answer(request)
            self._asking = False
            await self._send(answer)

    async def _send(self, telegram: bytes) -> None:
        if self._end.done():
            return
        self._record(Direction.SENT, telegram)
        try:
            self._writer.write(telegram)
            await asyncio.wait_for(self._writer.drain(), WRITE_TIMEOUT_S)
        except TimeoutError:
            self.end(EndReason.NOT_READING)
        except OSError as error:
            _log.info("eki.broken", error=repr(error))
            self.end(EndReason.BROKEN)

    def _record(self, direction: Direction, telegram: bytes) -> None:
        if self._on_telegram is not None:
            self._on_telegram(direction, telegram, time.monotonic())
