"""How is a register image served on a serial line?  `RtuRegisterServer`: one unit of the line, whoever is its master.

Frames for other units and garbage are passed over.  A reply leaves after the silence that separates frames.  A line
that is gone is opened again, again and again until `close`.
"""

import asyncio
import errno
import time
from collections.abc import Callable

import structlog

from slabcell_drivers.robot.modbus.access import Counters
from slabcell_drivers.robot.modbus.framing import ModbusFrame, RtuFramer, rtu_frame
from slabcell_drivers.robot.modbus.pdu import Store, answer_pdu
from slabcell_drivers.robot.modbus.serial_port import SerialPort, SerialSettings

__all__ = ["RtuRegisterServer"]

GARBAGE_SILENCE_S = 0.03
"""After this long without a byte what is incomplete is no frame: 3.5 characters, and what USB adapters add to it."""
_NOT_THERE = {errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.EIO}

_log = structlog.get_logger(__name__)


class RtuRegisterServer:
    """Serves a store on one line.

    ``heard`` is called before each request to our unit is served, ``lost`` when the line is gone.
    """

    def __init__(
        self,
        store: Store,
        settings: SerialSettings,
        *,
        unit_id: int,
        heard: Callable[[], None] = lambda: None,
        lost: Callable[[], None] = lambda: None,
        reopen_s: float = 1.0,
    ) -> None:
        self.counters = Counters()
        self._store, self._settings, self._unit_id = store, settings, unit_id
        self._heard, self._lost = heard, lost
        self._reopen_s = reopen_s
        self._framer = RtuFramer(unit_id)
        self._port: SerialPort | None = None
        self._open_from_s = 0.0
        self._silence: asyncio.TimerHandle | None = None
        self._reply: asyncio.TimerHandle | None = None
        self._closed = True

    def open(self) -> None:
        """Open the line; one that is not there yet is waited for.  Raises OSError if it may not be opened."""
        self._closed = False
        try:
            self._open_now()
        except OSError as error:
            if error.errno not in _NOT_THERE:
                self._closed = True
                raise
            _log.warning("modbus.line_absent", line=self._settings.url, error=str(error))

    def close(self) -> None:
        """Give the line back; may be called twice."""
        self._closed = True
        for timer in (self._silence, self._reply):
            if timer is not None:
                timer.cancel()
        if self._port is not None:
            self._port.close()
            self._port = None

    def look_at_time(self, now_s: float) -> None:
        """Open a lost line again, if it is time to; to be called now and then."""
        if self._closed or self._port is not None or now_s < self._open_from_s:
            return
        try:
            self._open_now()
        except OSError as error:
            self._open_from_s = now_s + self._reopen_s
            _log.debug("modbus.line_absent", line=self._settings.url, error=str(error))

    def _open_now(self) -> None:
        self._framer = RtuFramer(self._unit_id)
        self._port = SerialPort(self._settings, received=self._received, lost=self._line_lost)

    def _line_lost(self, error: Exception) -> None:
        _log.warning("modbus.line_lost", line=self._settings.url, error=str(error))
        self._port = None
        self._open_from_s = time.monotonic() + self._reopen_s
        self._lost()

    def _received(self, data: bytes) -> None:
        if self._silence is not None:
            self._silence.cancel()
            self._silence = None
        self._serve(self._framer.feed(data))
        if self._framer.pending:
            wait_s = max(GARBAGE_SILENCE_S, self._settings.silence_s)
            self._silence = asyncio.get_running_loop().call_later(wait_s, self._was_silent)

    def _was_silent(self) -> None:
        self._silence = None
        self.counters.malformed += 1
        self._serve(self._framer.silence())

    def _serve(self, frames: list[ModbusFrame]) -> None:
        for frame in frames:
            self._heard()
            self.counters.requests += 1
            pdu = answer_pdu(self._store, frame.pdu, lambda: True)
            self.counters.exceptions += pdu[0] >> 7
            if frame.unit != 0:  # a request to all units is not answered
                self._answer_after_silence(rtu_frame(frame.unit, pdu))

    def _answer_after_silence(self, frame: bytes) -> None:
        def answer() -> None:
            if self._port is not None:
                self._port.write(frame)

        if self._reply is not None:
            self._reply.cancel()  # its master has asked anew and waits for it no longer
        self._reply = asyncio.get_running_loop().call_later(self._settings.silence_s, answer)
