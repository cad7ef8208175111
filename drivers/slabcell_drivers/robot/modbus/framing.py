"""Where does one Modbus frame end and the next begin?  Bytes of a TCP stream or a serial line to frames; pure.

Over TCP a header says how long a frame is.  A header that cannot be right ends the connection, because nothing after it
can be trusted (MODBUS messaging on TCP/IP V1.0b, 3.1.3).  On a serial line there is no header: the length follows from
the function code, the CRC says whether it was right, and silence ends what nobody understood (MODBUS over serial line
V1.02, 2.5.1.1); a good frame after garbage is still found.
"""

from dataclasses import dataclass

from pymodbus.framer import FramerRTU

__all__ = [
    "MAX_PDU_BYTES",
    "FramingError",
    "ModbusFrame",
    "RtuFramer",
    "TcpFramer",
    "request_length",
    "rtu_frame",
    "tcp_frame",
]

MAX_PDU_BYTES = 253
MAX_RTU_BYTES = 256
_HEADER_BYTES = 7
_FIXED: dict[int, int] = dict.fromkeys((1, 2, 3, 4, 5, 6), 5)
_COUNTED = {15: 5, 16: 5, 23: 9}
"""Functions whose request tells at this place how many bytes follow."""


class FramingError(ValueError):
    """Bytes that are no frame."""


@dataclass(frozen=True, slots=True)
class ModbusFrame:
    """One request or response: to which unit, in which transaction (0 on a serial line), and what."""

    unit: int
    transaction: int
    pdu: bytes


class TcpFramer:
    """Cuts the stream of one TCP connection.  Holds less than one frame between calls."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Bytes held because their frame is not complete."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[ModbusFrame]:
        """Return the frames that are complete now.  Raises FramingError: the connection must end."""
        self._buffer += data
        frames: list[ModbusFrame] = []
        while len(self._buffer) >= _HEADER_BYTES:
            protocol, length = int.from_bytes(self._buffer[2:4]), int.from_bytes(self._buffer[4:6])
            if protocol != 0:
                raise FramingError(f"protocol identifier {protocol}; Modbus has 0")
            if not 2 <= length <= MAX_PDU_BYTES + 1:
                raise FramingError(f"a frame of {length} bytes; the limits are 2 and {MAX_PDU_BYTES + 1}")
            end = 6 + length
            if len(self._buffer) < end:
                break
            frames.append(
                ModbusFrame(self._buffer[6], int.from_bytes(self._buffer[0:2]), bytes(self._buffer[_HEADER_BYTES:end]))
            )
            del self._buffer[:end]
        return frames


def request_length(pdu: bytes) -> int | None:
    """Return the length of the request that begins so; 0 if more bytes are needed, None if the function is unknown."""
    if not pdu:
        return 0
    if (fixed := _FIXED.get(pdu[0])) is not None:
        return fixed
    if (place := _COUNTED.get(pdu[0])) is None:
        return None
    return place + 1 + pdu[place] if len(pdu) > place else 0


class RtuFramer:
    """Finds the requests to one unit (and to all, unit 0) in what a serial line delivers."""

    def __init__(self, unit_id: int) -> None:
        self._units = (unit_id, 0)
        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Bytes held because their frame is not complete."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[ModbusFrame]:
        """Return the frames that are complete now."""
        self._buffer += data
        frames = self._find(wait=True)
        if len(self._buffer) > 2 * MAX_RTU_BYTES:
            frames += self._find(wait=False)
            del self._buffer[:-MAX_RTU_BYTES]
        return frames

    def silence(self) -> list[ModbusFrame]:
        """Return what is complete now that the line was silent, and forget the rest, which is no frame."""
        frames = self._find(wait=False)
        self._buffer.clear()
        return frames

    def _find(self, *, wait: bool) -> list[ModbusFrame]:
        frames: list[ModbusFrame] = []
        start = 0
        while start < len(self._buffer):
            frame_bytes = self._frame_bytes(start)
            if frame_bytes is None or (frame_bytes == 0 and not wait):
                start += 1
            elif frame_bytes == 0:
                break
            else:
                end = start + frame_bytes
                frames.append(ModbusFrame(self._buffer[start], 0, bytes(self._buffer[start + 1 : end - 2])))
                start = end
        del self._buffer[:start]
        return frames

    def _frame_bytes(self, start: int) -> int | None:
        """Return how many bytes the frame that begins here has; 0 if it may become one, None if it is none."""
        if self._buffer[start] not in self._units:
            return None
        length = request_length(bytes(self._buffer[start + 1 : start + MAX_RTU_BYTES]))
        if length is None:
            return None
        end = start + 1 + length + 2
        if length == 0 or len(self._buffer) < end:
            return 0 if length <= MAX_PDU_BYTES else None
        body, crc = bytes(self._buffer[start : end - 2]), int.from_bytes(self._buffer[end - 2 : end])
        return end - start if FramerRTU.check_CRC(body, crc) else None


def rtu_frame(unit: int, pdu: bytes) -> bytes:
    """Return the bytes of a frame on a serial line."""
    body = bytes((unit,)) + pdu
    return body + FramerRTU.compute_CRC(body).to_bytes(2)


def tcp_frame(frame: ModbusFrame) -> bytes:
    """Return the bytes of a frame over TCP."""
    return (
        frame.transaction.to_bytes(2) + bytes(2) + (len(frame.pdu) + 1).to_bytes(2) + bytes((frame.unit,)) + frame.pdu
    )
