"""How do daemon and bench speak?  One JSON object and some blobs a message, on a pair of sockets.

No pickle: the child looks at files from outside, and the daemon must not run what comes back.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, cast

__all__ = ["Json", "Message", "WireError", "receive", "send"]

MAX_HEADER_BYTES: Final = 64 << 20
MAX_BLOBS: Final = 64
MAX_BLOB_BYTES: Final = 512 << 20
_HEAD: Final = struct.Struct(">II")
_LENGTH: Final = struct.Struct(">Q")

Json = dict[str, Any]


class WireError(Exception):
    """The other end is gone, or says what it must not."""


@dataclass(frozen=True, slots=True)
class Message:
    """What one end says to the other."""

    content: Json
    blobs: tuple[bytes, ...] = ()


def send(to: socket.socket, content: Mapping[str, Any], blobs: Sequence[bytes | memoryview] = ()) -> None:
    """Send one message; blocks.  Raises OSError."""
    header = json.dumps(content, allow_nan=False).encode()
    lengths = b"".join(_LENGTH.pack(len(blob)) for blob in blobs)
    to.sendall(_HEAD.pack(len(header), len(blobs)) + lengths + header)
    for blob in blobs:
        to.sendall(blob)


def receive(source: socket.socket) -> Message:
    """Return the next message; blocks.  Raises WireError, and TimeoutError as the socket is set."""
    header_bytes, blobs = _HEAD.unpack(_exactly(source, _HEAD.size))
    if header_bytes > MAX_HEADER_BYTES or blobs > MAX_BLOBS:
        msg = f"a message of {header_bytes} bytes with {blobs} blobs"
        raise WireError(msg)
    lengths = [int(_LENGTH.unpack(_exactly(source, _LENGTH.size))[0]) for _ in range(blobs)]
    if sum(lengths) > MAX_BLOB_BYTES:
        msg = f"blobs of {sum(lengths)} bytes"
        raise WireError(msg)
    content: object = json.loads(_exactly(source, header_bytes))
    if not isinstance(content, dict):
        msg = "a message that is no object"
        raise WireError(msg)
    return Message(cast("Json", content), tuple(bytes(_exactly(source, length)) for length in lengths))


def _exactly(source: socket.socket, count: int) -> bytearray:
    found = bytearray(count)
    view, at = memoryview(found), 0
    while at < count:
        got = source.recv_into(view[at:])
        if got == 0:
            msg = "the other end is gone"
            raise WireError(msg)
        at += got
    return found
