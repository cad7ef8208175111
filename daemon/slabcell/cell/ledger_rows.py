"""How does a row of the ledger become a value, and an error of SQLite become words?"""

import sqlite3
from pathlib import Path
from typing import cast

from slabcell.catalogue import Fault
from slabcell.cell.records import Job, JobState, OfferRecord, OfferState
from slabcell.errors import SlabcellError
from slabcell_drivers.robot.frame import Frame

__all__ = ["DAMAGE", "SELECT_OFFERS", "LedgerError", "named", "readable", "to_job", "to_offer"]

DAMAGE = (sqlite3.Error, UnicodeDecodeError)
"""What a damaged file can raise: damaged names within SQLite's own messages are no UTF-8."""

SELECT_OFFERS = (
    "SELECT result_id, job_id, cycle_id, idx, slot, state, score, pick_x, pick_y, pick_z, pick_a, pick_b, pick_c,"
    " place_x, place_y, place_z, place_a, place_b, place_c, reason, fault FROM offers"
)


class LedgerError(SlabcellError):
    """The ledger cannot be opened, read or written, or was asked for a step that it does not allow."""


def readable(raw: bytes) -> str:
    """Return text as it stands: damaged text must not be another exception than damaged pages."""
    return raw.decode("utf-8", errors="replace")


def to_offer(row: tuple[object, ...]) -> OfferRecord:
    """Return the value of a row of `SELECT_OFFERS`; raises ValueError or TypeError on a damaged one."""
    result_id, job_id, cycle_id, index, slot = cast("tuple[int, int, int, int, int]", row[:5])
    numbers = cast("tuple[float, ...]", row[7:19])
    return OfferRecord(
        *(result_id, job_id, cycle_id, index, slot, OfferState(cast("str", row[5])), cast("float", row[6])),
        Frame(*numbers[:6]),
        Frame(*numbers[6:]),
        cast("str", row[19]),
        cast("int", row[20]),
    )


def to_job(row: tuple[object, ...]) -> Job:
    """Return the value of a row of a job."""
    job_id, robot_job, recipe, sha, slots, state, x, y = cast("tuple[int, int, str, str, int, str, float, float]", row)
    return Job(job_id, robot_job, recipe, sha, slots, JobState(state), (x, y))


def named(path: Path, error: Exception) -> LedgerError:
    """Return the error as a person needs it: full disk, read-only, damaged, in use, or something else."""
    name = getattr(error, "sqlite_errorname", "")
    if name.startswith("SQLITE_FULL"):
        return LedgerError(f"{path}: the disk is full: free some space, then clear the alarm", number=Fault.DISK_FULL)
    if name.startswith(("SQLITE_READONLY", "SQLITE_IOERR", "SQLITE_CANTOPEN", "SQLITE_PERM")):
        return LedgerError(
            f"{path}: cannot be written ({name}: {error}); check disk and permissions", number=Fault.LEDGER_UNWRITABLE
        )
    if name.startswith(("SQLITE_CORRUPT", "SQLITE_NOTADB")) or isinstance(error, UnicodeDecodeError):
        return LedgerError(
            f"{path}: is damaged ({name or 'text'}: {error}); keep the file, and restore a copy",
            number=Fault.LEDGER_DAMAGED,
        )
    if name.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
        return LedgerError(
            f"{path}: is in use by another process; is a second slabcell running?", number=Fault.LEDGER_IN_USE
        )
    return LedgerError(f"{path}: {name or type(error).__name__}: {error}", number=Fault.LEDGER_ERROR)
