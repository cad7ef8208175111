"""How does a ledger leave its file, and come back?  As one JSON object, ``slabcell.ledger/1``, with every row.

A restored ledger gives result ids above all that it ever gave: the counters travel with the rows.
"""

import json
import os
import sqlite3
import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

from slabcell.catalogue import Fault
from slabcell.cell.ledger import LedgerError, LedgerFile
from slabcell.cell.schema import MIGRATIONS, TABLES

__all__ = ["SCHEMA", "export_document", "read_export", "restore", "set_aside", "write_export"]

SCHEMA = "slabcell.ledger/1"
MAX_BYTES = 512 << 20


def export_document(book: LedgerFile) -> dict[str, object]:
    """Return every row and the counters of the ids."""
    return {
        "schema": SCHEMA,
        "version": len(MIGRATIONS),
        "exported": datetime.now(UTC).isoformat(timespec="seconds"),
        "counters": book.counters(),
        "tables": {table: book.rows(table) for table in TABLES},
    }


def write_export(path: Path, document: Mapping[str, object]) -> None:
    """Write an export; the file appears complete or not at all.  Raises LedgerError."""
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                json.dump(document, stream, indent=1, allow_nan=False)
                stream.write("\n")
                stream.flush()
                os.fsync(stream.fileno())
            Path(temporary).replace(path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror}"
        raise LedgerError(msg, number=Fault.LEDGER_UNWRITABLE) from error


def read_export(path: Path) -> dict[str, object]:
    """Return the object of an export file.  Raises LedgerError."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise LedgerError(msg, number=Fault.LEDGER_UNWRITABLE) from error
    if len(raw) > MAX_BYTES:
        msg = f"{path}: is larger than {MAX_BYTES >> 20} MiB, which no export is"
        raise LedgerError(msg, number=Fault.LEDGER_DAMAGED)
    try:
        document: object = json.loads(raw)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        msg = f"{path}: is no JSON: {error}"
        raise LedgerError(msg, number=Fault.LEDGER_DAMAGED) from error
    if not isinstance(document, dict) or cast("dict[str, object]", document).get("schema") != SCHEMA:
        msg = f"{path}: is no export of a ledger: its schema is not {SCHEMA!r}"
        raise LedgerError(msg, number=Fault.LEDGER_DAMAGED)
    return cast("dict[str, object]", document)


def restore(path: Path, document: Mapping[str, object], source: str) -> None:
    """Make a ledger of an export; ``path`` must not exist.  Raises LedgerError, and leaves no file then."""
    if path.exists():
        msg = f"{path}: exists; set it aside first"
        raise LedgerError(msg, number=Fault.LEDGER_UNWRITABLE)
    if document.get("version") != len(MIGRATIONS):
        msg = f"{source}: is of schema {document.get('version')}, this version restores schema {len(MIGRATIONS)}"
        raise LedgerError(msg, number=Fault.LEDGER_NEWER)
    book = LedgerFile(path)
    try:
        book.fill(
            cast("Mapping[str, list[dict[str, object]]]", document["tables"]),
            cast("Mapping[str, int]", document["counters"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, sqlite3.Error, LedgerError) as error:
        book.close()
        for suffix in ("", "-wal", "-shm"):
            path.with_name(path.name + suffix).unlink(missing_ok=True)
        msg = f"{source}: is damaged, nothing was restored: {type(error).__name__}: {error}"
        raise LedgerError(msg, number=Fault.LEDGER_DAMAGED) from error
    book.close()


def set_aside(path: Path, *, now: datetime) -> Path:
    """Move a ledger that cannot be used out of the way, with its log; return where it is now."""
    target = path.with_name(f"{path.name}.corrupt.{now:%Y%m%dT%H%M%SZ}")
    for suffix in ("-wal", "-shm", ""):
        part = path.with_name(path.name + suffix)
        if part.exists():
            part.replace(target.with_name(target.name + suffix))
    return target
