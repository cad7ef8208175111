"""Where are bundles kept, and for how long?  Written by a thread of its own; the oldest go when there are too many.

What cannot be written is counted and reported: it never stops the cell.  A bundle appears complete or not at all.
Failures are kept longer than what went well: they are what somebody will want to look at.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import structlog

from slabcell.cell.bundle import BundleContext, Rows, bundle_bytes
from slabcell.cell.events import CycleRecord
from slabcell.cell.executor import end_executor
from slabcell_drivers.robot.protocol import ResultCode

__all__ = ["BundleWriter", "Retention"]

MAX_WAITING = 8
"""Bundles that may wait for the disk: each holds a picture in memory."""

FAILURE = "failure"
DAY_S = 86_400.0


@dataclass(frozen=True, slots=True)
class Retention:
    """How much is kept; failures have limits of their own.  Below ``min_free_bytes`` on the disk nothing is written."""

    max_bytes: int = 4 << 30
    max_age_s: float = 30 * DAY_S
    failures_max_bytes: int = 4 << 30
    failures_max_age_s: float = 365 * DAY_S
    min_free_bytes: int = 512 << 20


class BundleWriter:
    """Keeps bundles in a directory, which it creates.

    ``failed`` is told why one could not be kept, ``kept`` which cycle is in which file; both in the event loop.
    """

    def __init__(
        self, directory: Path, *, retention: Retention | None = None, failed: Callable[[str], None] | None = None
    ) -> None:
        self.directory = directory
        self.failed = failed
        self.kept: Callable[[CycleRecord, str], None] | None = None
        self.dropped = 0
        self._retention = retention or Retention()
        self._waiting = 0
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="slabcell-bundle")
        self._log = structlog.stdlib.get_logger("slabcell.bundle")

    def keep(self, cycle: CycleRecord, context: BundleContext, rows: Rows) -> None:
        """Have a finished cycle written; returns at once.  Called in the event loop."""
        if self._waiting >= MAX_WAITING:
            self.dropped += 1
            self._report(f"{self._waiting} bundles wait for the disk; {self.dropped} not kept so far")
            return
        created = datetime.now(UTC)
        name = f"{created:%Y%m%dT%H%M%S}.{created.microsecond // 1000:03d}Z_job{cycle.job_id}"
        path = self.directory / f"{name}_{cycle.session}-{cycle.trigger_sequence}_{_kind(cycle, rows)}.zip"
        pixels = cycle.frame.pixels if cycle.frame is not None else None

        def write() -> None:
            self.directory.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(self.directory).free
            if free < self._retention.min_free_bytes:
                msg = f"only {free >> 20} MiB are free, {self._retention.min_free_bytes >> 20} MiB must stay free"
                raise OSError(msg)
            content = bundle_bytes(cycle, pixels, context, rows, created.isoformat(timespec="milliseconds"))
            temporary = path.with_suffix(".part")
            try:
                with temporary.open("wb") as stream:
                    stream.write(content)
                    stream.flush()
                    os.fsync(stream.fileno())
                temporary.replace(path)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise
            prune(self.directory, self._retention, now_s=time.time(), spare=path)

        self._waiting += 1
        future = asyncio.get_running_loop().run_in_executor(self._writer, write)
        future.add_done_callback(lambda done: self._written(done, cycle, path.name))

    def _written(self, future: asyncio.Future[None], cycle: CycleRecord, name: str) -> None:
        self._waiting -= 1
        error = future.exception()
        if error is None:
            if self.kept is not None:
                self.kept(cycle, name)
        else:
            self.dropped += 1
            self._report(f"{self.directory}: {type(error).__name__}: {error}")

    def _report(self, detail: str) -> None:
        self._log.warning("bundle not kept", detail=detail)
        if self.failed is not None:
            self.failed(detail)

    async def close(self) -> None:
        """Wait for what is being written, and end the thread; may be called twice."""
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


def prune(directory: Path, retention: Retention, *, now_s: float, spare: Path) -> list[Path]:
    """Delete the oldest bundles beyond the limits, ``spare`` never; return what was deleted."""
    gone: list[Path] = []
    every = sorted(directory.glob("*.zip"), key=lambda path: path.name, reverse=True)  # newest first, by name
    for failures in (False, True):
        limit_bytes = retention.failures_max_bytes if failures else retention.max_bytes
        limit_age_s = retention.failures_max_age_s if failures else retention.max_age_s
        total = 0
        for path in every:
            if path.stem.endswith(f"_{FAILURE}") is not failures:
                continue
            try:
                status = path.stat()
            except FileNotFoundError:  # somebody tidied up by hand
                continue
            total += status.st_size
            if path != spare and (total > limit_bytes or now_s - status.st_mtime > limit_age_s):
                path.unlink(missing_ok=True)
                gone.append(path)
    return gone
