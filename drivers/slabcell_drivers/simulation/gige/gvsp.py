"""How does a picture become packets?  GVSP: leader, payload packets and trailer of one frame; no socket.

The packets of a frame lie in one block of memory, header and payload side by side, so that sending one is sending a
slice and sending one again needs no other copy.

Source: GigE Vision specification 1.2, GVSP: packet header, image leader and trailer.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.gvcp import Status

__all__ = ["OVERHEAD_BYTES", "FrameHead", "FramePackets", "next_block", "probe_packet", "unavailable_packet"]

OVERHEAD_BYTES: Final = 36
"""IP, UDP and GVSP headers: a packet size of 1500 carries 1464 bytes of picture."""
HEADER: Final = struct.Struct(">HHI")
_LEADER, _TRAILER, _PAYLOAD = 1 << 24, 2 << 24, 3 << 24
_IMAGE: Final = 1


@dataclass(frozen=True, slots=True)
class FrameHead:
    """What the leader says of a frame."""

    block: int
    timestamp_ns: int
    format_code: int
    width: int
    height: int
    offset_x: int = 0
    offset_y: int = 0


class FramePackets:
    """The packets of one frame, numbered from 0 (leader) to ``count`` - 1 (trailer).

    The memory is taken over from ``recycled`` where that fits.
    """

    def __init__(
        self,
        head: FrameHead,
        data: npt.NDArray[np.uint8],
        packet_size: int,
        recycled: "FramePackets | None" = None,
    ) -> None:
        room = packet_size - OVERHEAD_BYTES
        rows = max(1, -(-data.size // room))
        shape = (rows, HEADER.size + room)
        if recycled is not None and recycled._rows.shape == shape:
            self._rows = recycled._rows
        else:
            self._rows = np.zeros(shape, np.uint8)
            numbers = np.arange(1, rows + 1, dtype=np.uint32) | _PAYLOAD
            self._rows[:, 4:8] = numbers.astype(">u4").view(np.uint8).reshape(rows, 4)
        self.block = head.block
        self.count = rows + 2
        self._rows[:, 2] = head.block >> 8
        self._rows[:, 3] = head.block & 0xFF
        whole = data.size // room
        self._rows[:whole, HEADER.size :] = data[: whole * room].reshape(whole, room)
        rest = data.size - whole * room
        if rest:
            self._rows[whole, HEADER.size : HEADER.size + rest] = data[whole * room :]
        self._last = HEADER.size + (rest or room)
        self._view = self._rows.data.cast("B")
        self._stride = shape[1]
        self._leader = HEADER.pack(0, head.block, _LEADER) + struct.pack(
            ">HHQIIIIIHH", 0, _IMAGE, head.timestamp_ns, head.format_code, head.width, head.height, head.offset_x,
            head.offset_y, 0, 0,
        )  # fmt: skip
        self._trailer = HEADER.pack(0, head.block, _TRAILER | (rows + 1)) + struct.pack(">HHI", 0, _IMAGE, head.height)

    def packet(self, number: int) -> bytes | memoryview:
        """Return packet ``number``; the slice is valid until the frame's memory is taken over."""
        if number == 0:
            return self._leader
        if number == self.count - 1:
            return self._trailer
        start = (number - 1) * self._stride
        length = self._last if number == self.count - 2 else self._stride
        return self._view[start : start + length]

    def __iter__(self) -> Iterator[bytes | memoryview]:
        """Yield the packets in the order they are sent."""
        return map(self.packet, range(self.count))


def next_block(block: int) -> int:
    """Return the id of the frame after ``block``: 1 to 65535, then 1 again; 0 is never used."""
    return block % 65_535 + 1


def probe_packet(packet_size: int) -> bytes:
    """Return a packet of exactly the size that the client wants to see pass the network (less IP and UDP headers)."""
    return HEADER.pack(0, 0, 0).ljust(packet_size - 28, b"\0")


def unavailable_packet(block: int, number: int) -> bytes:
    """Return the answer to a request for a packet that the camera has forgotten."""
    return HEADER.pack(Status.PACKET_UNAVAILABLE, block, _PAYLOAD | (number & 0xFF_FFFF))
