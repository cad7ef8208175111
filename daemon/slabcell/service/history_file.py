"""How is the history kept on disk?  One SQLite file; what is too old goes, so that it stays bounded.

Blocking; used by one thread.  A listing walks an index backwards from a place, so that a page costs the same with a
hundred thousand cycles as with ten.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, cast

__all__ = ["AlarmRow", "Answered", "CycleRow", "HistoryFile"]

KEPT_CYCLES: Final = 200_000
KEPT_ALARMS: Final = 50_000
KEPT_REQUESTS: Final = 5_000
PRUNE_EVERY: Final = 256
APPLICATION_ID: Final = 0x736C6168  # "slah"
VERSION: Final = 1

_SCHEMA: Final = (
    """CREATE TABLE cycles (
        number INTEGER PRIMARY KEY,
        job_id INTEGER NOT NULL,
        verification INTEGER NOT NULL,
        code INTEGER NOT NULL,
        began_utc TEXT NOT NULL,
        document TEXT NOT NULL,
        bundle TEXT NOT NULL DEFAULT ''
    ) STRICT""",
    "CREATE INDEX cycles_by_job ON cycles (job_id, number)",
    "CREATE INDEX cycles_by_code ON cycles (code, number)",
    """CREATE TABLE alarms (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        number INTEGER NOT NULL,
        detail TEXT NOT NULL,
        came_utc TEXT NOT NULL,
        went_utc TEXT,
        why TEXT NOT NULL DEFAULT ''
    ) STRICT""",
    "CREATE INDEX alarms_standing ON alarms (number) WHERE went_utc IS NULL",
    """CREATE TABLE requests (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        key TEXT NOT NULL UNIQUE,
        fingerprint TEXT NOT NULL,
        user TEXT NOT NULL,
        path TEXT NOT NULL,
        at_utc TEXT NOT NULL,
        status INTEGER,
        media_type TEXT NOT NULL DEFAULT '',
        body BLOB NOT NULL DEFAULT x''
    ) STRICT""",
)


@dataclass(frozen=True, slots=True)
class CycleRow:
    """One ended cycle; ``document`` is its JSON object, ``bundle`` the name of its file, empty if none was kept."""

    number: int
    job_id: int
    verification: bool
    code: int
    began_utc: str
    document: str
    bundle: str = ""


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One alarm that came, and when it went, if it did."""

    id: int
    number: int
    detail: str
    came_utc: str
    went_utc: str | None
    why: str


@dataclass(frozen=True, slots=True)
class Answered:
    """A write that was asked for, and its answer; ``status`` is None as long as there is none."""

    fingerprint: str
    status: int | None = None
    media_type: str = ""
    body: bytes = b""


class HistoryFile:
    """The file.  Every method may raise sqlite3.Error."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._db = sqlite3.connect(path, timeout=2.0, isolation_level=None)
        self._writes = 0
        try:
            self._prepare()
        except BaseException:
            self._db.close()
            raise

    def _prepare(self) -> None:
        (application,) = self._db.execute("PRAGMA application_id").fetchone()
        (version,) = self._db.execute("PRAGMA user_version").fetchone()
        if (application, version) not in {(0, 0), (APPLICATION_ID, VERSION)}:
            msg = f"is no history of this version: application {application:#x}, version {version}"
            raise sqlite3.DatabaseError(msg)
        (verdict,) = self._db.execute("PRAGMA quick_check(1)").fetchone()
        if verdict != "ok":
            raise sqlite3.DatabaseError(str(verdict))
        self._db.execute("PRAGMA journal_mode=WAL")
        self._db.execute("PRAGMA synchronous=NORMAL")
        if version == 0:
            self._db.execute("BEGIN IMMEDIATE")
            for statement in _SCHEMA:
                self._db.execute(statement)
            self._db.execute(f"PRAGMA application_id={APPLICATION_ID}")
            self._db.execute(f"PRAGMA user_version={VERSION}")
            self._db.execute("COMMIT")
        # No part of the version: a file without it works, more slowly.
        self._db.execute("CREATE INDEX IF NOT EXISTS cycles_failed ON cycles (number) WHERE code >= 1000")

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._db.close()

    def _write(self, statement: str, values: Sequence[object]) -> None:
        self._db.execute(statement, values)
        self._writes += 1
        if self._writes % PRUNE_EVERY == 0:
            self._prune()

    def _prune(self) -> None:
        self._db.execute("DELETE FROM cycles WHERE number <= (SELECT max(number) FROM cycles) - ?", (KEPT_CYCLES,))
        for table, kept in (("alarms", KEPT_ALARMS), ("requests", KEPT_REQUESTS)):
            self._db.execute(f"DELETE FROM {table} WHERE id <= (SELECT max(id) FROM {table}) - ?", (kept,))  # noqa: S608 - two names

    # Cycles

    def last_cycle(self) -> int:
        """Return the number of the newest cycle, 0 if there is none."""
        (number,) = self._db.execute("SELECT coalesce(max(number), 0) FROM cycles").fetchone()
        return cast("int", number)

    def add_cycle(self, row: CycleRow) -> None:
        """Write an ended cycle."""
        self._write(
            "INSERT INTO cycles (number, job_id, verification, code, began_utc, document, bundle)"
            " VALUES (?, ?, ?, ?, ?, ?, ?)",
            (row.number, row.job_id, int(row.verification), row.code, row.began_utc, row.document, row.bundle),
        )

    def set_bundle(self, number: int, bundle: str) -> None:
        """Write where a cycle was kept."""
        self._write("UPDATE cycles SET bundle = ? WHERE number = ?", (bundle, number))

    def cycles(
        self,
        *,
        before: int,
        limit: int,
        job: int | None = None,
        failed: bool = False,
        code: int | None = None,
        since_utc: str | None = None,
        until_utc: str | None = None,
    ) -> list[CycleRow]:
        """Return a page of cycles, the newest first, with numbers below ``before``.

        Moments are as `CycleRow` has them.  Numbers ascend with time, so that a moment is found by halving; where the
        clock was set back in between, it is found somewhere there.
        """
        before = min(before, self._first_at(until_utc)) if until_utc else before
        where, values = ["number < ?", "number >= ?"], [before, self._first_at(since_utc) if since_utc else 0]
        if job is not None:
            where.append("job_id = ?")
            values.append(job)
        if code is not None:
            where.append("code = ?")
            values.append(code)
        if failed:
            where.append("code >= 1000")
        rows = self._db.execute(
            "SELECT number, job_id, verification, code, began_utc, document, bundle FROM cycles"  # noqa: S608 - fixed words
            f" WHERE {' AND '.join(where)} ORDER BY number DESC LIMIT ?",
            (*values, limit),
        ).fetchall()
        return [CycleRow(row[0], row[1], bool(row[2]), *row[3:]) for row in rows]

    def _first_at(self, moment_utc: str) -> int:
        """Return the number of the first cycle that began at a moment or later, or one after the last."""
        low, high = self._db.execute(
            "SELECT coalesce(min(number), 0), coalesce(max(number), 0) + 1 FROM cycles"
        ).fetchone()
        while low < high:
            middle = (low + high) // 2
            found = self._db.execute(
                "SELECT number, began_utc FROM cycles WHERE number >= ? ORDER BY number LIMIT 1", (middle,)
            ).fetchone()
            if found is None or found[1] >= moment_utc:
                high = middle
            else:
                low = found[0] + 1
        return cast("int", low)

    def cycle(self, number: int) -> CycleRow | None:
        """Return one cycle."""
        found = self.cycles(before=number + 1, limit=1)
        return found[0] if found and found[0].number == number else None

    # Alarms

    def alarm_came(self, number: int, detail: str, at_utc: str) -> None:
        """Write that an alarm came."""
        self._write("INSERT INTO alarms (number, detail, came_utc) VALUES (?, ?, ?)", (number, detail, at_utc))

    def alarm_went(self, number: int, why: str, at_utc: str) -> None:
        """Write that it went."""
        self._write(
            "UPDATE alarms SET went_utc = ?, why = ? WHERE number = ? AND went_utc IS NULL", (at_utc, why, number)
        )

    def end_alarms(self, at_utc: str) -> None:
        """Write of every alarm that stood when the daemon ended that it went: those that stand still come anew."""
        why = "the daemon ended"
        self._write("UPDATE alarms SET went_utc = ?, why = ? WHERE went_utc IS NULL", (at_utc, why))

    def alarms(self, *, before: int, limit: int) -> list[AlarmRow]:
        """Return a page of alarms, the newest first."""
        rows = self._db.execute(
            "SELECT id, number, detail, came_utc, went_utc, why FROM alarms WHERE id < ? ORDER BY id DESC LIMIT ?",
            (before, limit),
        ).fetchall()
        return [AlarmRow(*row) for row in rows]

    # Requests

    def request_begins(self, key: str, fingerprint: str, user: str, path: str, at_utc: str) -> Answered | None:
        """Return what is known of a key, or write that its work begins and return None."""
        row = self._db.execute(
            "SELECT fingerprint, status, media_type, body FROM requests WHERE key = ?", (key,)
        ).fetchone()
        if row is not None:
            return Answered(*row)
        self._write(
            "INSERT INTO requests (key, fingerprint, user, path, at_utc) VALUES (?, ?, ?, ?, ?)",
            (key, fingerprint, user, path, at_utc),
        )
        return None

    def request_ended(self, key: str, status: int, media_type: str, body: bytes) -> None:
        """Write the answer."""
        self._write(
            "UPDATE requests SET status = ?, media_type = ?, body = ? WHERE key = ?", (status, media_type, body, key)
        )
