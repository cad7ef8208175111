"""How long may the end take?  After that the process ends without the rest: what must last is on the disk already."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import sys
import threading
from collections.abc import Generator

import structlog

__all__ = ["END_WITHIN_S", "ended_in_time"]

END_WITHIN_S = 4.5
"""From the signal to the end: a person who stops the cell does not wait for a camera or a disk that hangs."""

EXIT_STATUS = 1

_log = structlog.get_logger(__name__)


@contextlib.contextmanager
def ended_in_time(limit_s: float = END_WITHIN_S) -> Generator[None]:
    """Close everything within; if that takes longer than the limit, say where it stands and end the process.

    A thread that is caught in a driver or in the kernel cannot be stopped in any other way.
    """
    watch = threading.Timer(limit_s, _give_up, args=[limit_s])
    watch.daemon = True
    watch.start()
    try:
        yield
    finally:
        watch.cancel()


def _give_up(limit_s: float) -> None:
    _log.error("not everything could be closed in time", limit_s=limit_s)
    faulthandler.dump_traceback(sys.__stderr__ or 2)
    os._exit(EXIT_STATUS)
