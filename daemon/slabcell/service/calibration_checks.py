"""What did checks of the calibration find over time?  A line of JSON for each, so that drift is seen before scrap.

A line that a power loss has cut is left out when the file is read; every other line stays.
"""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any, Final, cast

from slabcell.catalogue import Fault
from slabcell.errors import CalibrationError
from slabcell.service.atomic import write_atomically

__all__ = ["KEPT_CHECKS", "CheckLog"]

KEPT_CHECKS: Final = 2000
MAX_BYTES: Final = 64 << 20

Json = dict[str, Any]


class CheckLog:
    """The checks of one cell, the oldest first.  Methods block: run them in a thread."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()

    def read(self) -> list[Json]:
        """Return every check that is kept.  Raises CalibrationError."""
        with self._lock:
            return self._read()

    def _read(self) -> list[Json]:
        try:
            with self._path.open("rb") as stream:
                raw = stream.read(MAX_BYTES)
        except FileNotFoundError:
            return []
        except OSError as error:
            msg = f"{self._path}: cannot be read: {error.strerror}"
            raise CalibrationError(msg, number=Fault.STATE_UNWRITABLE) from error
        return [check for line in raw.splitlines() if (check := _parsed(line)) is not None]

    def add(self, check: Json) -> int:
        """Keep one more; return its number, which counts up.  Raises CalibrationError."""
        with self._lock:
            kept = self._read()
            number = 1 + max((int(item["check"]) for item in kept), default=0)
            line = _line({"check": number, **check})
            try:
                if len(kept) >= 2 * KEPT_CHECKS:
                    write_atomically(self._path, b"".join([*map(_line, kept[-KEPT_CHECKS:]), line]))
                else:
                    self._append(line)
            except OSError as error:
                msg = f"{self._path}: cannot be written: {error.strerror}"
                raise CalibrationError(msg, number=Fault.STATE_UNWRITABLE) from error
        return number

    def _append(self, line: bytes) -> None:
        with self._path.open("a+b") as stream:
            if stream.tell() > 0:
                stream.seek(-1, os.SEEK_END)
                if stream.read(1) != b"\n":  # a power loss cut the last one
                    line = b"\n" + line
            stream.write(line)
            stream.flush()
            os.fsync(stream.fileno())


def _line(check: Json) -> bytes:
    return json.dumps(check, allow_nan=False).encode() + b"\n"


def _parsed(line: bytes) -> Json | None:
    try:
        found: object = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    check = cast("Json", found)
    return check if isinstance(check.get("check"), int) and isinstance(check.get("at"), str) else None
