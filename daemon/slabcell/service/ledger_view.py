"""What stands in the ledger, page by page?  Reads it beside the cell, so that no listing delays an acknowledgement.

A second connection to the same file, read-only, in a thread of its own: with WAL a reader never holds up the writer.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from slabcell.cell.executor import end_executor
from slabcell.cell.ledger_rows import SELECT_OFFERS, LedgerError, named, readable, to_offer
from slabcell.cell.records import OfferRecord, OfferState, PlacementRecord

__all__ = ["JobRow", "LedgerView", "MeasurementRow", "SlotCounts", "count_slots"]

BUSY_TIMEOUT_S = 2.0

_T = TypeVar("_T")
_O = OfferState
_UNDER_WAY = frozenset({_O.PLANNED, _O.OFFERED, _O.ACCEPTED, _O.GRASPED})


@dataclass(frozen=True, slots=True)
class JobRow:
    """One job as the ledger has it."""

    job_id: int
    robot_job: int
    recipe: str
    template_sha256: str
    slots: int
    state: str
    began_utc: str
    ended_utc: str | None
    correction_x_mm: float
    correction_y_mm: float


@dataclass(frozen=True, slots=True)
class MeasurementRow:
    """One slab, measured once; lengths in mm, None where it was not found."""

    id: int
    job_id: int
    slot: int
    found: bool
    dx_mm: float | None
    dy_mm: float | None
    da_deg: float | None
    residual_mm: float | None
    at_utc: str


@dataclass(frozen=True, slots=True)
class SlotCounts:
    """The slots of a job; each is in one list."""

    laid: list[int]
    under_way: list[int]
    free: list[int]
    given_up: list[int]
    unknown: list[int]


def count_slots(slots: int, offers: Sequence[OfferRecord], *, attempts: int, forgiven_up_to: int = 0) -> SlotCounts:
    """Return what became of the slots: given up is one that failed ``attempts`` times since it was last forgiven."""
    of: dict[OfferState, set[int]] = {state: {o.slot for o in offers if o.state is state} for state in OfferState}
    failures = Counter(o.slot for o in offers if o.state is _O.FAILED and o.result_id > forgiven_up_to)
    under_way = set[int]().union(*(of[state] for state in _UNDER_WAY))
    open_slots = [slot for slot in range(slots) if slot not in of[_O.PLACED] | of[_O.UNKNOWN] | under_way]
    return SlotCounts(
        laid=sorted(of[_O.PLACED]),
        under_way=sorted(under_way),
        free=[slot for slot in open_slots if failures[slot] < attempts],
        given_up=[slot for slot in open_slots if failures[slot] >= attempts],
        unknown=sorted(of[_O.UNKNOWN]),
    )


_JOBS = (
    "SELECT job_id, robot_job, recipe, template_sha256, slots, state, began_utc, ended_utc, correction_x_mm,"
    " correction_y_mm FROM jobs"
)


class LedgerView:
    """Pages of a ledger.  Every method may raise LedgerError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="slabcell-ledger-view")
        self._db: sqlite3.Connection | None = None
        self._closed = False

    async def close(self) -> None:
        """Close the connection and end the thread; may be called twice."""
        if self._closed:
            return
        self._closed = True
        await asyncio.get_running_loop().run_in_executor(self._executor, self._disconnect)
        await end_executor(self._executor)

    def _disconnect(self) -> None:
        if self._db is not None:
            self._db.close()
            self._db = None

    async def _read(self, work: Callable[[sqlite3.Connection], _T]) -> _T:
        def run() -> _T:
            try:
                if self._db is None:
                    self._db = sqlite3.connect(
                        f"{self._path.absolute().as_uri()}?mode=ro", uri=True, timeout=BUSY_TIMEOUT_S
                    )
                    self._db.text_factory = readable
                return work(self._db)
            except (sqlite3.Error, UnicodeDecodeError) as error:
                self._disconnect()
                raise named(self._path, error) from error

        if self._closed:
            msg = f"{self._path}: is closed"
            raise LedgerError(msg)
        return await asyncio.get_running_loop().run_in_executor(self._executor, run)

    async def jobs(self, *, before: int, limit: int, state: str | None = None) -> list[JobRow]:
        """Return a page of jobs, the newest first, with numbers below ``before``."""
        where, values = ("job_id < ? AND state = ?", (before, state)) if state else ("job_id < ?", (before,))
        query = f"{_JOBS} WHERE {where} ORDER BY job_id DESC LIMIT ?"
        return await self._read(lambda db: [JobRow(*row) for row in db.execute(query, (*values, limit))])

    async def job(self, job_id: int) -> JobRow | None:
        """Return one job."""
        found = await self.jobs(before=job_id + 1, limit=1)
        return found[0] if found and found[0].job_id == job_id else None

    async def offers(self, job_ids: Sequence[int]) -> dict[int, list[OfferRecord]]:
        """Return the results of some jobs, in the order of their ids."""

        def read(db: sqlite3.Connection) -> dict[int, list[OfferRecord]]:
            found: dict[int, list[OfferRecord]] = {}
            for job_id in job_ids:
                rows = db.execute(f"{SELECT_OFFERS} WHERE job_id = ? ORDER BY result_id", (job_id,)).fetchall()
                found[job_id] = [to_offer(row) for row in rows]
            return found

        return await self._read(read)

    async def measurements(
        self, *, before: int, limit: int, job: int | None = None, slot: int | None = None
    ) -> list[MeasurementRow]:
        """Return a page of measurements, the newest first, with ids below ``before``."""
        where, values = ["placement_id < ?"], [before]
        for column, wanted in (("job_id", job), ("slot", slot)):
            if wanted is not None:
                where.append(f"{column} = ?")
                values.append(wanted)
        query = (
            "SELECT placement_id, job_id, slot, found, dx_mm, dy_mm, da_deg, residual_mm, at_utc FROM placements"  # noqa: S608 - fixed words
            f" WHERE {' AND '.join(where)} ORDER BY placement_id DESC LIMIT ?"
        )

        def read(db: sqlite3.Connection) -> list[MeasurementRow]:
            rows = db.execute(query, (*values, limit)).fetchall()
            return [MeasurementRow(row[0], row[1], row[2], bool(row[3]), *row[4:]) for row in rows]

        return await self._read(read)

    async def placements(self, job_id: int) -> list[PlacementRecord]:
        """Return how the slabs of a job were measured to lie last, in the order of the slots."""

        def read(db: sqlite3.Connection) -> list[PlacementRecord]:
            rows = db.execute(
                "SELECT slot, found, dx_mm, dy_mm, da_deg, residual_mm FROM placements WHERE placement_id IN"
                " (SELECT max(placement_id) FROM placements WHERE job_id = ? GROUP BY slot) ORDER BY slot",
                (job_id,),
            ).fetchall()
            nan = float("nan")
            return [
                PlacementRecord(slot, bool(found), *(nan if value is None else value for value in numbers))
                for slot, found, *numbers in rows
            ]

        return await self._read(read)
