"""What was there before the present?  Ended cycles, alarms, and what people did, kept on disk beside the ledger.

Nothing here decides anything: the ledger does.  So it is written after the fact, by a thread of its own, with a sync
now and then instead of one each time; power loss may cost the last lines.  A damaged file is set aside and begun anew.
A disk that refuses does not stop the cell: what cannot be written is counted, and the log says so.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import structlog

from slabcell.cell.executor import end_executor
from slabcell.cell.ledger_export import set_aside
from slabcell.errors import UnavailableError
from slabcell.service.history_file import AlarmRow, Answered, CycleRow, HistoryFile

__all__ = ["AlarmRow", "Answered", "CycleRow", "History", "utc_now"]

MAX_WAITING = 512
REMEMBERED_REQUESTS = 500

_T = TypeVar("_T")
_log = structlog.get_logger(__name__)


def utc_now() -> str:
    """Return the time of day as everything here is stamped with it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


class History:
    """The history of one cell.  Lines are added in the event loop, without waiting; pages are awaited."""

    def __init__(self, file: HistoryFile, executor: ThreadPoolExecutor, last_cycle: int) -> None:
        self._file = file
        self._executor = executor
        self._last_cycle = last_cycle
        self._waiting = 0
        self._failing = False
        self._closed = False
        self._remembered: OrderedDict[str, Answered] = OrderedDict()
        self.lost = 0
        """Lines that could not be written."""

    @classmethod
    async def open(cls, path: Path) -> History:
        """Open or create the file; a damaged one is set aside.  Raises UnavailableError."""
        executor = ThreadPoolExecutor(1, thread_name_prefix="slabcell-history")
        try:
            file, last = await asyncio.get_running_loop().run_in_executor(executor, _open, path)
        except (sqlite3.Error, OSError) as error:
            executor.shutdown(wait=False)
            msg = f"{path}: cannot be opened: {error}; check disk and permissions of the state directory"
            raise UnavailableError(msg) from error
        return cls(file, executor, last)

    async def close(self) -> None:
        """Write what waits, and close the file; may be called twice."""
        if self._closed:
            return
        self._closed = True
        await asyncio.get_running_loop().run_in_executor(self._executor, self._file.close)
        await end_executor(self._executor)

    # Lines

    def next_cycle(self) -> int:
        """Return the number of a new cycle."""
        self._last_cycle += 1
        return self._last_cycle

    def add_cycle(self, row: CycleRow) -> None:
        """Add an ended cycle."""
        self._later(lambda file: file.add_cycle(row))

    def set_bundle(self, number: int, bundle: str) -> None:
        """Add where a cycle was kept."""
        self._later(lambda file: file.set_bundle(number, bundle))

    def alarm_came(self, number: int, detail: str) -> None:
        """Add that an alarm came."""
        at_utc = utc_now()
        self._later(lambda file: file.alarm_came(number, detail, at_utc))

    def alarm_went(self, number: int, why: str) -> None:
        """Add that an alarm went."""
        at_utc = utc_now()
        self._later(lambda file: file.alarm_went(number, why, at_utc))

    def _later(self, work: Callable[[HistoryFile], None]) -> None:
        if self._waiting >= MAX_WAITING:
            self._lose(f"{self._waiting} lines wait for the disk")
            return
        self._waiting += 1
        future = asyncio.get_running_loop().run_in_executor(self._executor, work, self._file)
        future.add_done_callback(self._written)

    def _written(self, future: asyncio.Future[None]) -> None:
        self._waiting -= 1
        error = future.exception()
        if error is None:
            self._failing = False
        elif isinstance(error, sqlite3.Error):
            self._lose(str(error))
        else:
            raise error

    def _lose(self, detail: str) -> None:
        self.lost += 1
        if not self._failing:  # once, not with every line
            self._failing = True
            _log.warning("history not written", detail=detail, lost=self.lost)

    # Pages

    async def read(self, work: Callable[[HistoryFile], _T]) -> _T:
        """Return what ``work`` reads.  Raises UnavailableError if the file cannot be read."""
        try:
            return await asyncio.get_running_loop().run_in_executor(self._executor, work, self._file)
        except sqlite3.Error as error:
            msg = f"{self._file.path}: cannot be read: {error}"
            raise UnavailableError(msg) from error

    # Requests, which must be possible even where the disk refuses: a person has to be able to halt the cell

    async def request_begins(self, key: str, fingerprint: str, user: str, path: str) -> Answered | None:
        """Return what is known of a key, or note that its work begins and return None."""
        known = self._remembered.get(key)
        if known is not None:
            return known
        try:
            known = await asyncio.get_running_loop().run_in_executor(
                self._executor, self._file.request_begins, key, fingerprint, user, path, utc_now()
            )
        except sqlite3.Error as error:
            self._lose(str(error))
            known = None
        if known is None:
            self._remember(key, Answered(fingerprint))
        return known

    async def request_ended(self, key: str, status: int, media_type: str, body: bytes) -> None:
        """Note the answer."""
        self._remember(key, Answered(self._remembered[key].fingerprint, status, media_type, body))
        try:
            await asyncio.get_running_loop().run_in_executor(
                self._executor, self._file.request_ended, key, status, media_type, body
            )
        except sqlite3.Error as error:
            self._lose(str(error))

    def _remember(self, key: str, answered: Answered) -> None:
        self._remembered[key] = answered
        while len(self._remembered) > REMEMBERED_REQUESTS:
            self._remembered.popitem(last=False)


def _open(path: Path) -> tuple[HistoryFile, int]:
    try:
        file = HistoryFile(path)
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError):
            raise
        aside = set_aside(path, now=datetime.now(UTC))
        _log.warning("history set aside", file=str(aside), error=str(error))
        file = HistoryFile(path)
    file.end_alarms(utc_now())
    return file, file.last_cycle()
