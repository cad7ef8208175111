"""Does a camera answer, and does anybody control it?  Asked beside the driver's library, in milliseconds.

A library finds out that a camera is gone after seconds.  Any client may read a camera's registers, so one small
question over a socket of our own tells at once, and never waits for a library that hangs.
"""

import asyncio
import struct
import time
from enum import Enum
from typing import Final

from slabcell_drivers.camera.gvcp import (
    CCP_CONTROL,
    CCP_EXCLUSIVE,
    PORT,
    Command,
    GvcpError,
    Register,
    Request,
    Status,
    decode_answer,
    encode_request,
)

__all__ = ["Sight", "look"]

_REPEAT_S: Final = 0.1
_NUMBER: Final = 0x5EE5


class Sight(Enum):
    """What is seen of a camera."""

    SILENT = "it does not answer"
    FREE = "nobody controls it"
    CONTROLLED = "a client controls it"


async def look(address: str, timeout_s: float) -> Sight:
    """Ask the camera at an address who controls it, again every 0.1 s until it answers."""
    deadline_s = time.monotonic() + timeout_s
    request = Request(Command.READ_REGISTER, _NUMBER, struct.pack(">I", Register.CONTROL_PRIVILEGE))
    datagram = encode_request(request)
    loop = asyncio.get_running_loop()
    try:
        transport, listener = await loop.create_datagram_endpoint(_Listener, remote_addr=(address, PORT))
    except OSError:
        return Sight.SILENT  # no route to it
    try:
        while (left_s := deadline_s - time.monotonic()) > 0:
            transport.sendto(datagram)
            done, _ = await asyncio.wait({listener.seen}, timeout=min(_REPEAT_S, left_s))
            if done:
                return listener.seen.result()
        return Sight.SILENT
    finally:
        listener.seen.cancel()
        transport.close()
        await asyncio.sleep(0)  # lets the transport close its socket


class _Listener(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.seen: asyncio.Future[Sight] = asyncio.get_running_loop().create_future()

    def datagram_received(self, data: bytes, addr: object) -> None:
        del addr
        try:
            answer = decode_answer(data)
        except GvcpError:
            return
        if answer.number != _NUMBER or self.seen.done():
            return
        if answer.status == Status.ACCESS_DENIED:
            self.seen.set_result(Sight.CONTROLLED)  # somebody has exclusive access
        elif answer.status == Status.SUCCESS and len(answer.body) == 4:
            controlled = int.from_bytes(answer.body, "big") & (CCP_CONTROL | CCP_EXCLUSIVE)
            self.seen.set_result(Sight.CONTROLLED if controlled else Sight.FREE)

    def error_received(self, exc: Exception) -> None:
        del exc  # "connection refused": the host is there, the camera is not; the next question may find it
