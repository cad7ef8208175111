"""How long may the end take?  After that the process ends without the rest: what must last is on the disk already."""

from __future__ import annotations

import asyncio
import contextlib
import faulthandler
import os
import sys
import threading
from collections.abc import Generator

import structlog

from slabcell_drivers.camera import Camera

__all__ = ["END_WITHIN_S", "close_camera", "ended_in_time"]

END_WITHIN_S = 4.5
"""From the signal to the end: a person who stops the cell does not wait for a camera or a disk that hangs."""

CAMERA_WITHIN_S = 1.5

_log = structlog.get_logger(__name__)


@contextlib.contextmanager
def ended_in_time(limit_s: float = END_WITHIN_S) -> Generator[None]:
    """Close everything within: this process ends at the limit, if it has not by then.

    A thread that is caught in a driver or in the kernel cannot be stopped in any other way.  The exit status is 0 if
    only such threads were left, and 1 if something was not closed; the journal then says where every thread stood.
    """
    closed = threading.Event()

    def give_up() -> None:
        if not closed.is_set():
            _log.error("not everything could be closed in time", limit_s=limit_s)
            faulthandler.dump_traceback(sys.__stderr__ or 2)
        os._exit(0 if closed.is_set() else 1)

    watch = threading.Timer(limit_s, give_up)
    watch.daemon = True
    watch.start()
    yield
    closed.set()


async def close_camera(camera: Camera) -> None:
    """Give the camera back; one that is just being connected or does not answer is left to its driver's thread."""
    try:
        async with asyncio.timeout(CAMERA_WITHIN_S):
            await camera.close()
    except TimeoutError:
        _log.warning("the camera could not be given back in time", limit_s=CAMERA_WITHIN_S)
