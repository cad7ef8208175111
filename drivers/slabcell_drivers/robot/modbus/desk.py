"""How does a register image become a robot link?  `RequestDesk`: looks at what was written, asks the cell, answers.

The same for every way by which a PLC reaches the registers (TCP, serial line).
"""

import asyncio
import time
from collections.abc import Callable

import structlog

from slabcell_drivers.robot.answering import Answering
from slabcell_drivers.robot.link_events import Direction, TelegramHook
from slabcell_drivers.robot.modbus.codec import encode_answer
from slabcell_drivers.robot.modbus.exchange import Exchange
from slabcell_drivers.robot.modbus.gripper import NoGripper, PeerGripper
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.register_map import Area, Register, RegisterMap
from slabcell_drivers.robot.protocol import Answer, Handler, Request

__all__ = ["RequestDesk", "Status", "words_to_bytes"]

TICK_S = 0.1

_log = structlog.get_logger(__name__)


class Status:
    """Values of the status register."""

    NOT_READY, WAITING, WORKING = 0, 1, 2


class RequestDesk:
    """Answers the requests that appear in an image.

    ``failed`` is told that the desk could not go on with its peer (a hook raised); the peer's connection ends then.
    """

    def __init__(
        self,
        image: RegisterImage,
        handler: Handler,
        *,
        gripper: PeerGripper | None = None,
        on_telegram: TelegramHook | None = None,
        failed: Callable[[], None],
    ) -> None:
        self.image = image
        self.watchdog_changed_s: float | None = None
        """When the PLC's watchdog changed last, by the monotonic clock; None before its first change."""
        self.exchange = Exchange(image.map)
        self._gripper = gripper or NoGripper()
        self._on_telegram = on_telegram
        self._failed = failed
        self._answering = Answering(handler, self._sendable)
        self._work: set[asyncio.Task[None]] = set()
        self._ticking: asyncio.Task[None] | None = None
        self._watchdog = image.value(Area.PLC_LIFE, "watchdog")
        self._io_command = image.map.register(Area.PLC_LIFE, "io_command")
        image.written = self._written
        self._gripper.subscribe(self._show_gripper)
        self._show_gripper()
        self._set_status(Status.WAITING)

    def start(self) -> None:
        """Begin to count the cell's watchdog."""
        self._ticking = asyncio.get_running_loop().create_task(self._tick(), name="slabcell-modbus-watchdog")

    async def stop(self) -> None:
        """Finish what is under way; no task is left behind."""
        self.image.written = lambda _registers: None
        if self._ticking is not None:
            self._ticking.cancel()
            await asyncio.gather(self._ticking, return_exceptions=True)
        await asyncio.gather(*self._work, return_exceptions=True)
        self._set_status(Status.NOT_READY)

    def new_peer(self) -> None:
        """Forget the old peer's watchdog: the new one may have none."""
        self.watchdog_changed_s = None

    def _written(self, registers: frozenset[Register]) -> None:
        areas = {register.area for register in registers}
        if Area.PLC_LIFE in areas:
            watchdog = self.image.value(Area.PLC_LIFE, "watchdog")
            if watchdog != self._watchdog:
                self._watchdog, self.watchdog_changed_s = watchdog, time.monotonic()
            self.image.set_value(Area.CELL_LIFE, "watchdog_echo", watchdog)
        if self._io_command in registers:  # and not with the watchdog alone: after a restart nothing is wished for yet
            self._gripper.wish(vacuum=bool(self.image.value(Area.PLC_LIFE, "io_command") & 1))
        if Area.REQUEST in areas:
            self._look()

    def _look(self) -> None:
        words = self.image.get(Area.REQUEST)
        got = self.exchange.take(words)
        if got is None:
            return
        try:
            self._record(Direction.RECEIVED, words)
        except Exception:  # noqa: BLE001 - a hook's fault: its peer is dropped, and the link lives on
            _log.exception("modbus.hook_failed")
            self.exchange.drop()
            self._failed()
            return
        if isinstance(got, Answer):
            self._show(got)
            return
        self._set_status(Status.WORKING)
        task = asyncio.get_running_loop().create_task(self._answer(got), name="slabcell-modbus-request")
        self._work.add(task)
        task.add_done_callback(self._work.discard)

    def _sendable(self, answer: Answer) -> Answer:
        """Return an answer that the registers can hold.  Raises ValueError for another."""
        encode(self.image.map, answer)
        return answer

    async def _answer(self, request: Request) -> None:
        answer = await self._answering.answer(request)
        self._set_status(Status.WAITING)
        self._show(answer)

    def _show(self, answer: Answer) -> None:
        words = self.exchange.show(answer, self.image.get(Area.REQUEST))
        if words is not None:
            self.image.set(Area.ANSWER, words)
            try:
                self._record(Direction.SENT, words)
            except Exception:  # noqa: BLE001 - as above
                _log.exception("modbus.hook_failed")
                self._failed()
        else:
            _log.info("modbus.answer_dropped", sequence=answer.acknowledges)
        self._look()

    def _record(self, direction: Direction, words: list[int]) -> None:
        if self._on_telegram is not None:
            self._on_telegram(direction, words_to_bytes(words), time.monotonic())

    def _set_status(self, status: int) -> None:
        self.image.set_value(Area.CELL_LIFE, "status", status)

    async def _tick(self) -> None:
        while True:
            self.image.set_value(Area.CELL_LIFE, "watchdog", self.image.value(Area.CELL_LIFE, "watchdog") + 1)
            await asyncio.sleep(TICK_S)

    def _show_gripper(self) -> None:
        self.image.set_value(Area.CELL_LIFE, "io_state", self._gripper.state_bits)


def encode(register_map: RegisterMap, answer: Answer) -> list[int]:
    """Write an answer to see whether it can be written.  Raises RegisterValueError."""
    return encode_answer(register_map, answer, publication=0, toggle=0)


def words_to_bytes(words: list[int]) -> bytes:
    """Return words as a transcript keeps them: two bytes each, the high one first."""
    return b"".join(word.to_bytes(2, "big") for word in words)
