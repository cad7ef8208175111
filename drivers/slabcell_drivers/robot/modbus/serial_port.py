"""How is a serial line used from asyncio?  `SerialPort`: pyserial opens and sets it, the event loop waits for it."""

import asyncio
import contextlib
import termios
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import serial

__all__ = ["SerialPort", "SerialSettings"]

READ_BYTES = 1024
MAX_UNSENT_BYTES = 16 * 1024


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """Which line, and how it is set; ``url`` is a device, or anything of pyserial's with a file (socket://HOST:PORT)."""

    url: str
    baud_rate: int = 19_200
    parity: Literal["N", "E", "O"] = "E"  # the default of MODBUS over serial line V1.02, 2.5.1
    stop_bits: Literal[1, 2] = 1

    @property
    def silence_s(self) -> float:
        """The time of 3.5 characters of 11 bits, which separates frames (V1.02, 2.5.1.1: 1.75 ms above 19200 baud)."""
        return 0.00175 if self.baud_rate > 19_200 else 3.5 * 11 / self.baud_rate


class SerialPort:
    """An open line.  ``received`` is called with bytes, ``lost`` once when the line is gone; both in the event loop."""

    def __init__(
        self, settings: SerialSettings, *, received: Callable[[bytes], None], lost: Callable[[Exception], None]
    ) -> None:
        """Open the line.  Raises OSError (serial.SerialException is one)."""
        self._received, self._lost = received, lost
        self._serial = serial.serial_for_url(
            settings.url,
            baudrate=settings.baud_rate,
            parity=settings.parity,
            stopbits=settings.stop_bits,
            timeout=0,
            write_timeout=0,
            do_not_open=True,
        )
        with contextlib.suppress(ValueError, AttributeError):  # URLs other than devices know no lock
            self._serial.exclusive = True
        try:
            self._serial.open()
        except termios.error as error:  # for example a pseudo-terminal, which has no parity
            self._serial.close()
            message = f"{settings.url}: refuses {settings.baud_rate} baud, parity {settings.parity}: {error}"
            raise OSError(message) from error
        try:
            self._file = int(self._serial.fileno())
        except (OSError, AttributeError) as error:
            self._serial.close()
            raise OSError(f"{settings.url}: has no file to wait for; use a device or socket://HOST:PORT") from error
        self._loop = asyncio.get_running_loop()
        self._unsent: deque[bytes] = deque()
        self._open = True
        self._loop.add_reader(self._file, self._readable)

    def write(self, data: bytes) -> None:
        """Send as soon as the line takes it.  A line that takes nothing any more counts as lost."""
        if not self._open:
            return
        if sum(map(len, self._unsent)) > MAX_UNSENT_BYTES:
            self._fail(OSError("the line takes no bytes"))
            return
        self._unsent.append(data)
        self._writable()

    def close(self) -> None:
        """Give the line back; may be called twice."""
        if self._open:
            self._open = False
            self._loop.remove_reader(self._file)
            self._loop.remove_writer(self._file)
            self._serial.close()

    def _readable(self) -> None:
        try:
            data = bytes(self._serial.read(READ_BYTES))
        except OSError as error:  # serial.SerialException, also for a line whose other end hung up
            self._fail(error)
            return
        if data:
            self._received(data)

    def _writable(self) -> None:
        try:
            while self._unsent:
                data = self._unsent[0]
                sent = self._serial.write(data) or 0
                if sent < len(data):
                    self._unsent[0] = data[sent:]
                    self._loop.add_writer(self._file, self._writable)
                    return
                self._unsent.popleft()
        except OSError as error:
            self._fail(error)
            return
        self._loop.remove_writer(self._file)

    def _fail(self, error: Exception) -> None:
        if self._open:
            self.close()
            self._lost(error)
