"""What was offered to the robot, and what became of it?  The durable record, in SQLite.

`LedgerFile` is the file itself, plain and blocking; `Ledger` runs it in a thread of its own for asyncio.  Every method
that writes is one transaction, and with WAL and ``synchronous=FULL`` one transaction is one fsync; several within one
`LedgerFile.step` are one transaction together.  What must hold is in the schema, not only in the code: result ids
strictly increase over restarts (AUTOINCREMENT), a slot of a job has at most one slab that is laid, under way or
unresolved, and at most one slab at a time is in the robot's hand.

Source of the durability rules: SQLite documentation, "PRAGMA synchronous" and "Write-Ahead Logging".
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import astuple
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar, cast

from slabcell.catalogue import Fault
from slabcell.cell.ledger_rows import DAMAGE, SELECT_OFFERS, LedgerError, named, readable, to_job, to_offer
from slabcell.cell.records import STEPS, Job, JobState, OfferRecord, OfferState, Pair, PlacementRecord
from slabcell.cell.schema import MIGRATIONS, TABLES

__all__ = ["Ledger", "LedgerError", "LedgerFile"]

APPLICATION_ID = 0x736C6162  # "slab": tells our file from any other SQLite file
BUSY_TIMEOUT_S = 2.0
CHECKPOINT_PAGES = 8000
"""The log is folded into the file when a job ends (`LedgerFile.tidy`); this bounds it (32 MiB) if none ever does."""

_T = TypeVar("_T")
_O = OfferState


def _utc_now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _in_memory(path: Path) -> sqlite3.Connection:
    """Return a copy of a database, read without a lock that would make its writer wait."""
    source = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=BUSY_TIMEOUT_S)
    copy = sqlite3.connect(":memory:", isolation_level=None)
    try:
        source.backup(copy)
    except BaseException:
        copy.close()
        raise
    finally:
        source.close()
    return copy


class LedgerFile:
    """The ledger's file.  Blocking; used by one thread.

    Raises `LedgerError` on a file that cannot be opened, is damaged, or was written by a newer version.
    """

    def __init__(self, path: Path, *, now: Callable[[], str] = _utc_now, copy: bool = False) -> None:
        """Open or create the file; with ``copy`` take a copy of it into memory, and leave the file alone.

        A copy is what the file held at one moment, whatever a daemon writes meanwhile.
        """
        self.path = path
        self._now = now
        try:
            if copy:
                self._db = _in_memory(path)
            else:
                self._db = sqlite3.connect(path, timeout=BUSY_TIMEOUT_S, isolation_level=None)
        except DAMAGE as error:
            if copy:
                raise named(path, error) from error
            msg = f"{path}: cannot be opened: {error}; check that the directory exists and may be written"
            raise LedgerError(msg, number=Fault.LEDGER_UNWRITABLE) from error
        # Damaged text must not be another exception than damaged pages: it is shown as it is.
        self._db.text_factory = readable
        try:
            self._prepare()
        except BaseException:
            self._db.close()
            raise

    def _prepare(self) -> None:
        try:
            (application,) = self._db.execute("PRAGMA application_id").fetchone()
            (version,) = self._db.execute("PRAGMA user_version").fetchone()
            if (application, version) != (0, 0) and application != APPLICATION_ID:
                msg = f"{self.path}: is an SQLite file, but not a ledger of slabcell; name another file"
                raise LedgerError(msg, number=Fault.LEDGER_DAMAGED)
            if version > len(MIGRATIONS):
                msg = (
                    f"{self.path}: has schema {version}, this version knows schemas up to {len(MIGRATIONS)};"
                    " install the newer version again, or restore the ledger that belongs to this one"
                )
                raise LedgerError(msg, number=Fault.LEDGER_NEWER)
            (verdict,) = self._db.execute("PRAGMA quick_check(1)").fetchone()
            if verdict != "ok":
                msg = f"{self.path}: is damaged: {verdict}; keep the file, and restore a copy"
                raise LedgerError(msg, number=Fault.LEDGER_DAMAGED)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute(f"PRAGMA wal_autocheckpoint={CHECKPOINT_PAGES}")
            self._db.execute("PRAGMA foreign_keys=ON")
            for step, script in enumerate(MIGRATIONS[version:], start=version + 1):
                with self.step():
                    for statement in script:
                        self._db.execute(statement)
                    self._db.execute(f"PRAGMA application_id={APPLICATION_ID}")
                    self._db.execute(f"PRAGMA user_version={step}")
        except DAMAGE as error:
            raise named(self.path, error) from error

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._db.close()

    @contextmanager
    def step(self) -> Generator[None]:
        """One durable step, one fsync: all of what is written within, or nothing.

        A step within a step is part of it.
        """
        if self._db.in_transaction:
            yield
            return
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
        except BaseException as error:
            if self._db.in_transaction:  # SQLite itself rolls back after some errors (full disk, I/O), not after all
                self._db.execute("ROLLBACK")
            if isinstance(error, DAMAGE):
                raise named(self.path, error) from error
            raise

    def tidy(self) -> None:
        """Fold the write-ahead log into the file, which costs syncs of its own; for when nobody waits."""
        self._rows("PRAGMA wal_checkpoint(PASSIVE)")

    def _rows(self, query: str, *values: object) -> list[tuple[object, ...]]:
        try:
            return self._db.execute(query, values).fetchall()
        except DAMAGE as error:
            raise named(self.path, error) from error

    def new_session(self, cause: str) -> int:
        """Return a session number larger than any before."""
        with self.step():
            cursor = self._db.execute("INSERT INTO sessions (began_utc, cause) VALUES (?, ?)", (self._now(), cause))
            return cast("int", cursor.lastrowid)

    def keep_above(self, result_id: int) -> None:
        """See to it that every result id to come is larger than ``result_id``, which a robot remembers."""
        with self.step():
            self._db.execute(
                "INSERT INTO sqlite_sequence (name, seq) SELECT 'offers', 0"
                " WHERE NOT EXISTS (SELECT 1 FROM sqlite_sequence WHERE name = 'offers')"
            )
            self._db.execute("UPDATE sqlite_sequence SET seq = max(seq, ?) WHERE name = 'offers'", (result_id,))

    def last_job(self) -> Job | None:
        """Return the job begun last."""
        rows = self._rows(
            "SELECT job_id, robot_job, recipe, template_sha256, slots, state, correction_x_mm, correction_y_mm"
            " FROM jobs ORDER BY job_id DESC LIMIT 1"
        )
        return to_job(rows[0]) if rows else None

    def begin_job(
        self,
        robot_job: int,
        recipe: str,
        template_sha256: str,
        slots: int,
        correction_mm: tuple[float, float] = (0.0, 0.0),
    ) -> Job:
        """Return a new open job."""
        with self.step():
            cursor = self._db.execute(
                "INSERT INTO jobs (robot_job, recipe, template_sha256, slots, state, began_utc, correction_x_mm,"
                " correction_y_mm) VALUES (?, ?, ?, ?, 'open', ?, ?, ?)",
                (robot_job, recipe, template_sha256, slots, self._now(), *correction_mm),
            )
        job_id = cast("int", cursor.lastrowid)
        return Job(job_id, robot_job, recipe, template_sha256, slots, JobState.OPEN, correction_mm)

    def end_job(self, job_id: int, state: JobState) -> None:
        """Close a job."""
        with self.step():
            self._db.execute(
                "UPDATE jobs SET state = ?, ended_utc = ? WHERE job_id = ?", (state.value, self._now(), job_id)
            )

    def record_cycle(
        self, job_id: int, session: int, sequence: int, pairs: Sequence[Pair], *, offer_first: bool = False
    ) -> list[OfferRecord]:
        """Write one cycle and its results, in the order in which they shall be laid; return them with their ids.

        With ``offer_first`` the first one is written as offered at once: the robot may hear of it from now on.
        """
        with self.step():
            now = self._now()
            cursor = self._db.execute(
                "INSERT INTO cycles (job_id, session, trigger_sequence, began_utc) VALUES (?, ?, ?, ?)",
                (job_id, session, sequence, now),
            )
            cycle_id = cast("int", cursor.lastrowid)
            offers: list[OfferRecord] = []
            for index, pair in enumerate(pairs):
                state = _O.OFFERED if offer_first and index == 0 else _O.PLANNED
                cursor = self._db.execute(
                    "INSERT INTO offers (job_id, cycle_id, idx, slot, state, score, reason, changed_utc,"
                    " pick_x, pick_y, pick_z, pick_a, pick_b, pick_c,"
                    " place_x, place_y, place_z, place_a, place_b, place_c)"
                    " VALUES (?, ?, ?, ?, ?, ?, '', ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    (
                        *(job_id, cycle_id, index, pair.slot, state.value, pair.score, now),
                        *pair.pick.as_tuple(),
                        *pair.place.as_tuple(),
                    ),
                )
                result_id = cast("int", cursor.lastrowid)
                offers.append(
                    OfferRecord(
                        result_id, job_id, cycle_id, index, pair.slot, state, pair.score, pair.pick, pair.place, ""
                    )
                )
            if offer_first and offers:
                self._write_said(offers[0].result_id, _O.OFFERED, session, sequence, "", now)
        return offers

    def move(
        self,
        result_id: int,
        state: OfferState,
        *,
        session: int = 0,
        sequence: int = 0,
        reason: str = "",
        fault: int = 0,
    ) -> OfferRecord:
        """Write that a result is now in ``state``, and who said so.  The state it is in already is no error.

        ``fault`` is the number of the alarm that a person has to clear before the result is settled.

        Raises `LedgerError` for an unknown result and for a step that the ledger does not allow.
        """
        before = self.offer(result_id)
        if before is None:
            msg = f"result {result_id} is not in the ledger"
            raise LedgerError(msg, number=Fault.LEDGER_ERROR)
        if before.state is state:
            return before
        if state not in STEPS[before.state]:
            msg = f"result {result_id} is {before.state} and cannot become {state}"
            raise LedgerError(msg, number=Fault.LEDGER_ERROR)
        with self.step():
            self._write_state(result_id, state, session, sequence, reason, fault)
        after = self.offer(result_id)
        assert after is not None  # noqa: S101  (written in this thread a line above)
        return after

    def void(self, job_id: int, *, session: int = 0, reason: str) -> list[int]:
        """Take back what the robot has not begun with (planned or offered); return the result ids."""
        ids = [
            cast("int", row[0])
            for row in self._rows(
                "SELECT result_id FROM offers WHERE job_id = ? AND state IN ('planned', 'offered')", job_id
            )
        ]
        if ids:
            with self.step():
                for result_id in ids:
                    self._write_state(result_id, _O.VOID, session, 0, reason, 0)
        return ids

    def _write_state(
        self, result_id: int, state: OfferState, session: int, sequence: int, reason: str, fault: int
    ) -> None:
        now = self._now()
        self._db.execute(
            "UPDATE offers SET state = ?, reason = ?, fault = ?, changed_utc = ? WHERE result_id = ?",
            (state.value, reason, fault, now, result_id),
        )
        self._write_said(result_id, state, session, sequence, reason, now)

    def _write_said(
        self, result_id: int, state: OfferState, session: int, sequence: int, reason: str, now: str
    ) -> None:
        self._db.execute(
            "INSERT INTO acknowledgements (result_id, state, session, sequence, reason, at_utc)"
            " VALUES (?, ?, ?, ?, ?, ?)",
            (result_id, state.value, session, sequence, reason, now),
        )

    def offer(self, result_id: int) -> OfferRecord | None:
        """Return one result."""
        offers = self._offers(f"{SELECT_OFFERS} WHERE result_id = ?", result_id)
        return offers[0] if offers else None

    def offers(self, job_id: int) -> list[OfferRecord]:
        """Return the results of a job in the order of their ids."""
        return self._offers(f"{SELECT_OFFERS} WHERE job_id = ? ORDER BY result_id", job_id)

    def _offers(self, query: str, value: int) -> list[OfferRecord]:
        try:
            return [to_offer(row) for row in self._rows(query, value)]
        except (ValueError, TypeError) as error:
            msg = f"{self.path}: is damaged: a result cannot be read: {error}; keep the file, and restore a copy"
            raise LedgerError(msg, number=Fault.LEDGER_DAMAGED) from error

    def record_placements(self, job_id: int, placements: Sequence[PlacementRecord]) -> None:
        """Write how the slabs of a job lie."""
        with self.step():
            self._db.executemany(
                "INSERT INTO placements (job_id, slot, found, dx_mm, dy_mm, da_deg, residual_mm, at_utc)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                [(job_id, *astuple(item), self._now()) for item in placements],
            )

    def rows(self, table: str, job_id: int | None = None) -> list[dict[str, object]]:
        """Return the rows of a table as they stand, of one job if the table knows of jobs."""
        if table not in TABLES:
            msg = f"the ledger has no table {table!r}; it has {', '.join(TABLES)}"
            raise LedgerError(msg, number=Fault.LEDGER_ERROR)
        where = "" if job_id is None else " WHERE job_id = ?"
        if table == "acknowledgements" and job_id is not None:
            where = " WHERE result_id IN (SELECT result_id FROM offers WHERE job_id = ?)"
        try:
            cursor = self._db.execute(
                f"SELECT * FROM {table}{where} ORDER BY 1",  # noqa: S608  (the name was checked against a fixed list)
                () if job_id is None else (job_id,),
            )
            names = [column[0] for column in cursor.description]
            return [dict(zip(names, row, strict=True)) for row in cursor.fetchall()]
        except DAMAGE as error:
            raise named(self.path, error) from error

    def systematic_error(self, template_sha256: str) -> tuple[int, float, float]:
        """Return over how many slabs, and by how much in x and y (mm), jobs of a template are off without a correction.

        As the last complete job of the template showed it: the mean of what was measured, less its own correction.
        """
        rows = self._rows(
            "SELECT count(*), avg(dx_mm) - max(correction_x_mm), avg(dy_mm) - max(correction_y_mm)"
            " FROM placements JOIN jobs USING (job_id) WHERE found AND dx_mm IS NOT NULL AND job_id ="
            " (SELECT max(job_id) FROM jobs WHERE state = 'complete' AND template_sha256 = ?)",
            template_sha256,
        )
        number, dx_mm, dy_mm = cast("tuple[int, float | None, float | None]", rows[0])
        return number, dx_mm or 0.0, dy_mm or 0.0

    def counters(self) -> dict[str, int]:
        """Return the largest id that each table ever gave."""
        rows = self._rows("SELECT name, seq FROM sqlite_sequence ORDER BY name")
        return {str(name): cast("int", largest) for name, largest in rows}

    def fill(self, tables: Mapping[str, list[dict[str, object]]], counters: Mapping[str, int]) -> None:
        """Write rows and counters of an export into a ledger that is still empty, in one transaction."""
        with self.step():
            for table in TABLES:
                known = {str(row[1]) for row in self._db.execute(f"PRAGMA table_info({table})")}
                for row in tables[table]:
                    if set(row) != known:
                        msg = f"a row of {table} has the columns {', '.join(row)}, not {', '.join(sorted(known))}"
                        raise ValueError(msg)
                    names = ", ".join(row)  # checked against the table's own names
                    marks = ", ".join("?" * len(row))
                    self._db.execute(f"INSERT INTO {table} ({names}) VALUES ({marks})", tuple(row.values()))  # noqa: S608
            for table, largest in counters.items():
                if table not in TABLES:
                    msg = f"there is no table {table!r}"
                    raise ValueError(msg)
                self._db.execute("DELETE FROM sqlite_sequence WHERE name = ?", (table,))
                self._db.execute("INSERT INTO sqlite_sequence (name, seq) VALUES (?, ?)", (table, int(largest)))

    def excerpt(self, job_id: int) -> dict[str, list[dict[str, object]]]:
        """Return the rows of every table that belong to a job."""
        return {table: self.rows(table, job_id) for table in TABLES if table != "sessions"}


class Ledger:
    """The ledger for asyncio: one thread, one step after the other."""

    def __init__(self, file: LedgerFile, executor: ThreadPoolExecutor) -> None:
        self._file = file
        self._executor = executor
        self._closed = False

    @classmethod
    async def open(cls, path: Path, *, now: Callable[[], str] = _utc_now) -> Ledger:
        """Open or create the file.  ``now`` tells the time that is written beside each step.  Raises `LedgerError`."""
        executor = ThreadPoolExecutor(1, thread_name_prefix="slabcell-ledger")
        try:
            file = await asyncio.get_running_loop().run_in_executor(executor, lambda: LedgerFile(path, now=now))
        except BaseException:
            executor.shutdown(wait=False)
            raise
        return cls(file, executor)

    async def run(self, work: Callable[[LedgerFile], _T]) -> _T:
        """Return what ``work`` returns in the ledger's thread.  A cancelled caller does not undo the work."""
        if self._closed:
            msg = f"{self._file.path}: is closed"
            raise LedgerError(msg, number=Fault.LEDGER_UNWRITABLE)
        return await asyncio.get_running_loop().run_in_executor(self._executor, work, self._file)

    async def close(self) -> None:
        """Close the file and end the thread; may be called twice."""
        if self._closed:
            return
        self._closed = True
        await asyncio.get_running_loop().run_in_executor(self._executor, self._file.close)
        self._executor.shutdown(wait=True)
