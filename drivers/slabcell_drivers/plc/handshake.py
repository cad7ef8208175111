"""How does a PLC ask the cell?  The PLC's side of the handshake, as its program would do it.

1. Read the answer's toggle; write the request area; last of all write the request's toggle as the opposite.
2. Read the answer until its toggle is the request's.  It counts if it is whole (the same publication at both ends,
   check words right) and acknowledges this request's sequence number.
3. An answer to something else is passed over: ask again, with the toggle turned once more.
4. Nothing in time: write the same request again; the cell gives the same answer.
"""

import asyncio
import time
from collections.abc import Callable

from slabcell_drivers.plc.registers import RegisterPort
from slabcell_drivers.robot.modbus.codec import decode_answer, encode_request
from slabcell_drivers.robot.modbus.register_map import Area, RegisterMap, RegisterValueError
from slabcell_drivers.robot.protocol import Answer, Request, RequestType

__all__ = ["LinkLostError", "PlcHandshake"]

READ_WORDS = 64
"""So many registers are read at once, as by a PLC with small buffers: an answer takes two reads."""
WATCHDOG_S = 0.3


class LinkLostError(OSError):
    """The cell did not answer in time."""


class SessionLostError(LinkLostError):
    """The cell has begun another session: the robot has to greet again."""


class PlcHandshake:
    """Asks through a port.  ``write_words`` limits how many registers go in one write, as small PLCs do."""

    def __init__(
        self,
        port: RegisterPort,
        register_map: RegisterMap,
        *,
        poll_s: float = 0.01,
        ask_again_s: float = 1.0,
        write_words: int = 123,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._port, self._map = port, register_map
        self._poll_s, self._ask_again_s = poll_s, ask_again_s
        self._write_words = write_words
        self._clock = clock
        self._watchdog = 0
        self._io_command = 0
        self.torn_reads = 0
        """How often an answer was read that was not whole."""
        self.foreign_answers = 0
        """How often an answer was to something else."""

    async def ask(self, request: Request, timeout_s: float) -> Answer:
        """Return the answer to one request.  Raises LinkLostError if none comes in time."""
        deadline_s = self._clock() + timeout_s
        last_error: Exception | None = None
        while self._clock() < deadline_s:
            try:
                if not self._port.connected:
                    await self._port.connect()
                answer = await self._ask_once(request, min(deadline_s, self._clock() + self._ask_again_s))
            except SessionLostError:
                raise
            except OSError as error:  # a poll that failed
                last_error = error
                await asyncio.sleep(self._poll_s)
                continue
            if answer is not None:
                return answer
        raise LinkLostError(f"{request.type.name} {request.sequence}: no answer within {timeout_s} s") from last_error

    async def _ask_once(self, request: Request, until_s: float) -> Answer | None:
        """Write the request and wait a while; None if it has to be asked again."""
        toggle = 1 - ((await self._read(Area.ANSWER))[-1] & 1)
        await self._write(Area.REQUEST, encode_request(self._map, request, toggle))
        while self._clock() < until_s:
            words = await self._read(Area.ANSWER)
            if words[-1] == toggle:
                if self._map.sound(Area.ANSWER, words):
                    return self._mine(request, words)
                self.torn_reads += 1
            await asyncio.sleep(self._poll_s)
        return None

    def _mine(self, request: Request, words: list[int]) -> Answer | None:
        try:
            answer = decode_answer(self._map, words)
        except RegisterValueError:
            self.foreign_answers += 1
            return None
        if answer.acknowledges != request.sequence:
            self.foreign_answers += 1
            return None
        if request.type is not RequestType.HELLO and answer.session != request.session:
            raise SessionLostError(f"the cell speaks in session {answer.session}, the request was of {request.session}")
        return answer

    async def _read(self, area: Area) -> list[int]:
        start, count = self._map.span(area)
        words: list[int] = []
        for at in range(0, count, READ_WORDS):
            words += await self._port.read(start + at, min(READ_WORDS, count - at))
        return words

    async def _write(self, area: Area, words: list[int]) -> None:
        """Write an area in pieces, and its toggle last of all, by itself."""
        start = self._map.span(area)[0]
        body = words[:-1]
        for at in range(0, len(body), self._write_words):
            await self._port.write(start + at, body[at : at + self._write_words])
        await self._port.write(start + len(body), words[-1:])

    # ---------------------------------------------------------------------------------------------------- life signs

    async def beat(self) -> None:
        """Change the watchdog once.  Raises OSError."""
        self._watchdog = (self._watchdog + 1) & 0xFFFF
        await self._write_life()

    async def keep_beating(self) -> None:
        """Change the watchdog again and again, until cancelled; what fails is tried again."""
        while True:
            try:
                if self._port.connected:
                    await self.beat()
            except OSError:
                self._watchdog -= 1  # the next one tells
            await asyncio.sleep(WATCHDOG_S)

    async def set_vacuum(self, *, on: bool) -> None:
        """Wish for vacuum, where the gripper hangs on the cell PC.  Raises OSError."""
        self._io_command = int(on)
        await self._write_life()

    async def gripper_state(self) -> int:
        """Return the io_state register.  Raises OSError."""
        register = self._map.register(Area.CELL_LIFE, "io_state")
        return (await self._port.read(register.address, 1))[0]

    async def _write_life(self) -> None:
        words = self._map.encode(Area.PLC_LIFE, {"watchdog": self._watchdog, "io_command": self._io_command})
        await self._port.write(self._map.span(Area.PLC_LIFE)[0], words)
