"""Can the state directory be written?  Writes and syncs a small file there once a second, in a thread of its own.

A disk that refuses, or does not answer in time, is named within two seconds, and the alarm goes when it is back.  It is
*not* responsible for what could not be written meanwhile: the ledger says that itself.
"""

from __future__ import annotations

import asyncio
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from slabcell.catalogue import Fault
from slabcell.cell.alarms import Alarms
from slabcell.service.links import LinkName, Links, LinkState

__all__ = ["DiskWatch"]

EVERY_S = 0.8
ANSWERS_WITHIN_S = 1.0
PROBE = b"slabcell\n"


class DiskWatch:
    """Watches one directory from `run` until it is cancelled."""

    def __init__(self, folder: Path, alarms: Alarms, links: Links) -> None:
        self._path = folder / ".probe"
        self._alarms = alarms
        self._links = links
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="slabcell-disk")

    async def run(self) -> None:
        """Look until cancelled."""
        loop = asyncio.get_running_loop()
        try:
            while True:
                probing = loop.run_in_executor(self._writer, _probe, self._path)
                done, _ = await asyncio.wait({probing}, timeout=ANSWERS_WITHIN_S)
                if not done:
                    self._down(f"{self._path.parent}: no answer within {ANSWERS_WITHIN_S:g} s")
                    await asyncio.wait(
                        {probing}
                    )  # a thread in the kernel cannot be stopped: it ends when the disk does
                error = probing.exception()
                if error is None:
                    self._up()
                elif isinstance(error, OSError):
                    self._down(f"{self._path.parent}: cannot be written: {error.strerror}")
                else:
                    raise error
                await asyncio.sleep(EVERY_S)
        finally:
            self._writer.shutdown(wait=False)

    def _up(self) -> None:
        if self._links.set(LinkName.DISK, LinkState.UP, str(self._path.parent)):
            self._alarms.cease(Fault.STATE_UNWRITABLE)

    def _down(self, detail: str) -> None:
        self._links.set(LinkName.DISK, LinkState.DOWN, detail)
        self._alarms.come(Fault.STATE_UNWRITABLE, detail)


def _probe(path: Path) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC | os.O_NOFOLLOW, 0o640)
    try:
        os.write(handle, PROBE)
        os.fdatasync(handle)
    finally:
        os.close(handle)
