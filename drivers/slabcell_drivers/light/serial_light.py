"""How is a light controller on a serial line used?  `SerialLight`: pyserial in a thread, one command at a time.

``url`` is anything of pyserial's: a device, ``socket://HOST:PORT`` (a serial device server, or a controller with
Ethernet), ``rfc2217://HOST:PORT``.  A controller that does not answer is asked once more, and is lost then; `check`
connects it again and sets every channel as it was.
"""

import asyncio
import contextlib
import math
import termios
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import serial
import structlog

from slabcell_drivers.light.presets import MAX_REPLY_BYTES, Preset
from slabcell_drivers.light.protocol import (
    LightConfigError,
    LightInfo,
    LightLost,
    LightSetting,
    LightState,
)

__all__ = ["SerialLight"]

TRIES = 2
READ_S = 0.05
CHECK_WITHIN_S = 1.4
"""A controller that does not answer a check, and the same again, in this time is lost: that is known within 2 s."""

_T = TypeVar("_T")
_log = structlog.get_logger(__name__)


class SerialLight:
    """A `Light` that speaks a preset."""

    def __init__(self, url: str, preset: Preset, *, baud_rate: int | None = None) -> None:
        """Take note of where it is.  Raises LightConfigError if neither the preset nor the caller names a baud rate."""
        baud = baud_rate or preset.baud_rate
        if baud is None:
            raise LightConfigError(f"{preset.title}: the manual's pages that were read give no baud rate: name it")
        self._url, self._preset, self._baud_rate = url, preset, baud
        self._settings: dict[int, LightSetting] = {}
        self._state = LightState.CLOSED
        self._worker: ThreadPoolExecutor | None = None
        self._port: serial.Serial | None = None
        self._sent_s = 0.0

    @property
    def state(self) -> LightState:
        """Where the controller stands now."""
        return self._state

    async def open(self) -> LightInfo:
        """Connect, and see that the controller answers."""
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="slabcell-light")
        identity = await self._call(self._connect)
        return LightInfo(self._preset.title, identity)

    async def on(self, setting: LightSetting) -> None:
        """Have a channel shine, or pulse with each trigger."""
        commands = self._preset.commands_for(setting)
        self._settings[setting.channel] = setting
        await self._call(lambda: self._send_all(commands))

    async def off(self, channel: int) -> None:
        """Turn a channel off."""
        commands = self._preset.off_commands(channel)
        self._settings.pop(channel, None)
        await self._call(lambda: self._send_all(commands))

    async def trigger(self, channel: int) -> None:
        """Have a channel that is set to strobe pulse once."""
        command = self._preset.trigger_command(channel)
        await self._call(lambda: self._send_all([command]))

    async def check(self) -> None:
        """See that the controller answers; connect a lost one again and set it as it was."""
        lost = self._state is not LightState.READY
        await self._call(self._connect if lost else self._ping)
        if lost:
            for setting in tuple(self._settings.values()):
                await self.on(setting)

    async def close(self) -> None:
        """Give the line back; the light stays as it is."""
        worker, self._worker = self._worker, None
        if worker is not None:
            await asyncio.get_running_loop().run_in_executor(worker, self._disconnect)
            worker.shutdown(wait=True)
        self._state = LightState.CLOSED

    async def _call(self, work: Callable[[], _T]) -> _T:
        if self._worker is None:
            raise LightLost(f"{self._url}: open the light before it is used")
        try:
            result = await asyncio.get_running_loop().run_in_executor(self._worker, work)
        except LightLost:
            if self._state is not LightState.CLOSED:
                self._state = LightState.LOST
            raise
        self._state = LightState.READY
        return result

    # ----------------------------------------------------------------------------------------- in the worker's thread

    def _connect(self) -> str:
        self._disconnect()
        try:
            # pyserial's rfc2217.py refuses a write timeout; the socket below it has one of five seconds
            write_s = None if self._url.startswith("rfc2217:") else 1.0
            port = serial.serial_for_url(
                self._url, baudrate=self._baud_rate, timeout=READ_S, write_timeout=write_s, do_not_open=True
            )
            with contextlib.suppress(ValueError, AttributeError):  # URLs other than devices know no lock
                port.exclusive = True
            port.open()
            self._port = port
        except (OSError, ValueError, termios.error) as error:
            raise LightLost(f"{self._url}: cannot be opened: {error}; check the cable and the name") from error
        identity = self._ping()
        _log.info("light.connected", url=self._url, identity=identity)
        return identity

    def _disconnect(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(OSError):
                port.close()

    def _ping(self) -> str:
        channel = next(iter(self._settings), 1)
        command = self._preset.check_command(channel, on=channel in self._settings)
        return self._ask(command, time.monotonic() + CHECK_WITHIN_S)

    def _send_all(self, commands: list[bytes]) -> None:
        for command in commands:
            self._ask(command)

    def _ask(self, command: bytes, until_s: float = math.inf) -> str:
        problem: Exception | None = None
        for _ in range(TRIES):
            try:
                return self._preset.judge(self._exchange(command, until_s), command)
            except (OSError, ValueError, termios.error) as error:  # LightRefused is none: who refuses is there
                problem = error
                _log.debug("light.no_answer", url=self._url, command=command, error=str(error))
        self._disconnect()
        raise LightLost(f"{self._url}: the controller does not answer: {problem}; check power and cable") from problem

    def _exchange(self, command: bytes, until_s: float) -> str:
        port = self._port
        if port is None:
            raise OSError("the line is not open")
        pause_s = self._sent_s + self._preset.pause_ms / 1000.0 - time.monotonic()
        if pause_s > 0:
            time.sleep(pause_s)  # the controller's own pace
        port.reset_input_buffer()  # what came late to an earlier command
        port.write(command)
        self._sent_s = time.monotonic()
        end, reply = self._preset.reply_end.encode("ascii"), bytearray()
        deadline_s = min(self._sent_s + self._preset.reply_timeout_ms / 1000.0, until_s)
        while not reply.endswith(end):
            if time.monotonic() > deadline_s:
                waited_ms = (deadline_s - self._sent_s) * 1000.0
                raise TimeoutError(f"no reply within {waited_ms:.0f} ms, {bytes(reply)[:40]!r} came")
            if len(reply) >= MAX_REPLY_BYTES:
                raise ValueError(f"{len(reply)} bytes without the end of a reply")
            reply += port.read(1)
        return bytes(reply[: -len(end)]).decode("ascii", "replace")
