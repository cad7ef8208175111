"""How do bundles get to the disk?  Written by a thread of its own, while the cell goes on and the robot does not wait.

What cannot be written is counted and reported: it never stops the cell.  A bundle appears complete or not at all.  How
long each is kept is the matter of `slabcell.cell.retention`.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import structlog

from slabcell.cell.bundle import BundleContext, Rows, bundle_bytes
from slabcell.cell.events import CycleRecord
from slabcell.cell.executor import end_executor
from slabcell.cell.leisure import Leisure
from slabcell.cell.retention import FAILURE, Retention, make_room, next_number, prune
from slabcell_drivers.robot.protocol import ResultCode

__all__ = ["BundleWriter"]

MAX_WAITING = 8
"""Bundles that may wait for the disk: each holds a picture in memory."""

PATIENCE_S = 1.0
"""So long each part of a bundle waits for a moment in which the robot does not; no longer once many bundles wait."""


class BundleWriter:
    """Keeps bundles in a directory, which it creates.

    ``failed`` is told why one could not be kept, ``kept`` which cycle is in which file; both in the event loop.
    """

    def __init__(
        self,
        directory: Path,
        *,
        retention: Retention | None = None,
        failed: Callable[[str], None] | None = None,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self.directory = directory
        self.failed = failed
        self.kept: Callable[[CycleRecord, str], None] | None = None
        self.dropped = 0
        self.leisure = Leisure()
        self._retention = retention or Retention()
        self._now = now
        self._number = 0  # of the next bundle; known once the directory was looked at, by the writer's thread
        self._waiting = 0
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="slabcell-bundle")
        self._log = structlog.stdlib.get_logger("slabcell.bundle")

    def keep(self, cycle: CycleRecord, context: BundleContext, rows: Rows) -> None:
        """Have a finished cycle written; returns at once.  Called in the event loop."""
        if self._waiting >= MAX_WAITING:
            self.dropped += 1
            self._report(f"{self._waiting} bundles wait for the disk; {self.dropped} not kept so far")
            return
        created = self._now()
        about = f"{created:%Y%m%dT%H%M%S}.{created.microsecond // 1000:03d}Z_job{cycle.job_id}"
        about += f"_{cycle.session}-{cycle.trigger_sequence}_{_kind(cycle, rows)}.zip"
        pixels = cycle.frame.pixels if cycle.frame is not None else None

        def pause() -> None:
            self.leisure.wait(PATIENCE_S, urgent=lambda: self._waiting > MAX_WAITING // 2)

        def write() -> str:
            pause()
            self._prepare()
            make_room(self.directory, self._retention)
            written_utc = created.isoformat(timespec="milliseconds")
            content = bundle_bytes(cycle, pixels, context, rows, written_utc, pause=pause)
            path = self.directory / f"{self._number:08d}_{about}"
            temporary = path.with_suffix(".part")
            try:
                pause()
                with temporary.open("wb") as stream:
                    stream.write(content)
                    stream.flush()
                    os.fsync(stream.fileno())
                temporary.replace(path)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise
            self._number += 1
            pause()
            prune(self.directory, self._retention, now_s=self._now().timestamp(), spare=path)
            return path.name

        self._waiting += 1
        future = asyncio.get_running_loop().run_in_executor(self._writer, write)
        future.add_done_callback(lambda done: self._written(done, cycle))

    def _prepare(self) -> None:
        """Make the directory, tidy up after a process that was ended while it wrote, and learn the next number."""
        self.directory.mkdir(parents=True, exist_ok=True)
        if not self._number:
            for leftover in self.directory.glob("*.part"):
                leftover.unlink(missing_ok=True)
            self._number = next_number(self.directory)

    def _written(self, future: asyncio.Future[str], cycle: CycleRecord) -> None:
        self._waiting -= 1
        error = future.exception()
        if error is None:
            if self.kept is not None:
                self.kept(cycle, future.result())
        else:
            self.dropped += 1
            self._report(f"{self.directory}: {_reason(error)}")

    def _report(self, detail: str) -> None:
        self._log.warning("bundle not kept", detail=detail)
        if self.failed is not None:
            self.failed(detail)

    async def close(self) -> None:
        """Wait for what is being written, and end the thread; may be called twice."""
        self.leisure.end()
        await end_executor(self._writer)
        await asyncio.sleep(0)  # lets the callbacks of the last bundles run


def _kind(cycle: CycleRecord, rows: Rows) -> str:
    """Return the word in the file's name that says why somebody may want to look at it."""
    unlucky = any(
        row["cycle_id"] == cycle.cycle_id and row["state"] in {"failed", "unknown"} for row in rows.get("offers", ())
    )
    if unlucky or cycle.code not in {ResultCode.OK, ResultCode.JOB_COMPLETE}:
        return FAILURE
    return "verification" if cycle.verification else "cycle"


def _reason(error: BaseException) -> str:
    """Return in words why a bundle was not written; what is no trouble of the disk keeps its type."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"{type(error).__name__}: {error}"
