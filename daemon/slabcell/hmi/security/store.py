"""Where are users, logins and the audit log kept?  In one SQLite file that only the HMI's own user can read.

Blocking; used by one thread, in which `Store.run` has its work done.  A file that is damaged, or of a later version, is
not replaced: who could log in would change silently.  The HMI then refuses to start and names the file.
"""

from __future__ import annotations

import asyncio
import sqlite3
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final, TypeVar

import structlog

from slabcell.errors import SlabcellError, UnavailableError

__all__ = ["Store"]

APPLICATION_ID: Final = 0x736C6875  # "slhu"
VERSION: Final = 1

_SCHEMA: Final = (
    """CREATE TABLE users (
        name TEXT PRIMARY KEY,
        role TEXT NOT NULL,
        password_hash TEXT NOT NULL,
        created_utc TEXT NOT NULL
    ) STRICT""",
    """CREATE TABLE sessions (
        token_sha256 TEXT PRIMARY KEY,
        user TEXT NOT NULL REFERENCES users (name) ON DELETE CASCADE,
        csrf TEXT NOT NULL,
        address TEXT NOT NULL,
        began_s REAL NOT NULL,
        used_s REAL NOT NULL
    ) STRICT""",
    """CREATE TABLE audit (
        id INTEGER PRIMARY KEY AUTOINCREMENT,
        at_utc TEXT NOT NULL,
        user TEXT NOT NULL,
        role TEXT NOT NULL,
        address TEXT NOT NULL,
        action TEXT NOT NULL,
        content TEXT NOT NULL,
        status INTEGER NOT NULL,
        outcome TEXT NOT NULL
    ) STRICT""",
)

_T = TypeVar("_T")

_log = structlog.get_logger(__name__)


class Store:
    """The open file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="slabcell-hmi-store")
        self._db: sqlite3.Connection | None = None

    async def open(self) -> None:
        """Open or create the file.  Raises UnavailableError, or SlabcellError for one that must not be used."""
        try:
            await asyncio.get_running_loop().run_in_executor(self._executor, self._open)
        except (OSError, sqlite3.Error) as error:
            msg = f"{self.path}: cannot be used: {error}; put it back from a backup, or move it away to begin anew"
            raise UnavailableError(msg) from error

    def _open(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.path.touch(mode=0o600)
        mode = stat.S_IMODE(self.path.stat().st_mode)
        if mode & 0o077:
            self.path.chmod(0o600)
            _log.warning("file of users was open to others", path=str(self.path), mode=f"{mode:o}")
        db = sqlite3.connect(self.path, timeout=5.0, isolation_level=None, check_same_thread=False)
        try:
            _prepare(db)
        except BaseException:
            db.close()
            raise
        self._db = db

    async def run(self, work: Callable[[sqlite3.Connection], _T]) -> _T:
        """Return what ``work`` does with the file.  Raises UnavailableError if the file refuses."""
        if self._db is None:
            msg = f"{self.path}: is not open"
            raise SlabcellError(msg)
        try:
            return await asyncio.get_running_loop().run_in_executor(self._executor, work, self._db)
        except sqlite3.IntegrityError:
            raise
        except sqlite3.Error as error:
            msg = f"{self.path}: refuses: {error}; check the disk of the HMI's state directory"
            raise UnavailableError(msg) from error

    async def close(self) -> None:
        """Close the file and end the thread; may be called twice."""
        db, self._db = self._db, None
        if db is not None:
            await asyncio.get_running_loop().run_in_executor(self._executor, db.close)
        self._executor.shutdown(wait=True)


def _prepare(db: sqlite3.Connection) -> None:
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (version,) = db.execute("PRAGMA user_version").fetchone()
    if (application, version) not in {(0, 0), (APPLICATION_ID, VERSION)}:
        msg = f"is no file of users of this version: application {application:#x}, version {version}"
        raise sqlite3.DatabaseError(msg)
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA synchronous=FULL")
    db.execute("PRAGMA foreign_keys=ON")
    if version == 0:
        db.execute("BEGIN IMMEDIATE")
        for statement in _SCHEMA:
            db.execute(statement)
        db.execute(f"PRAGMA application_id={APPLICATION_ID}")
        db.execute(f"PRAGMA user_version={VERSION}")
        db.execute("COMMIT")
