"""Which bundles are kept, and which have to go?

Failures are kept longer than what went well: they are what somebody will want to look at.  The oldest is the one with
the smallest number before its name, which only ever rises, and not the one with the earliest time: clocks jump.  For
the same reason age alone deletes a few bundles at a time: a clock that is years ahead for an hour must not cost what
was kept for years.
"""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

__all__ = ["DAY_S", "FAILURE", "Retention", "make_room", "next_number", "prune"]

FAILURE = "failure"
DAY_S = 86_400.0
MOST_AGED_OUT = 2
"""So many are deleted for their age with each bundle that is written: more than come, and not all at once."""

_NUMBER = re.compile(r"(\d{8,})_")


@dataclass(frozen=True, slots=True)
class Retention:
    """How much is kept; failures have limits of their own.

    With less than ``min_free_bytes`` on the disk, bundles of what went well make room; if that is not enough, nothing
    is written: the room is left to the ledger.
    """

    max_bytes: int = 4 << 30
    max_age_s: float = 30 * DAY_S
    failures_max_bytes: int = 4 << 30
    failures_max_age_s: float = 365 * DAY_S
    min_free_bytes: int = 512 << 20


def prune(directory: Path, retention: Retention, *, now_s: float, spare: Path) -> list[Path]:
    """Delete the oldest bundles beyond the limits, ``spare`` never; return what was deleted."""
    gone: list[Path] = []
    for failures in (False, True):
        limit_bytes = retention.failures_max_bytes if failures else retention.max_bytes
        limit_age_s = retention.failures_max_age_s if failures else retention.max_age_s
        total = 0
        aged: list[Path] = []
        for path in _newest_first(directory, failures=failures):
            status = _status(path)
            if status is None:
                continue
            total += status.st_size
            if path == spare:
                continue
            if total > limit_bytes:
                path.unlink(missing_ok=True)
                gone.append(path)
            elif now_s - status.st_mtime > limit_age_s:
                aged.append(path)
        for path in aged[-MOST_AGED_OUT:]:
            path.unlink(missing_ok=True)
            gone.append(path)
    return gone


def make_room(directory: Path, retention: Retention) -> None:
    """See to it that the disk has its free space.  Raises OSError with the figures if that cannot be."""
    going = _newest_first(directory, failures=False)
    while (free := shutil.disk_usage(directory).free) < retention.min_free_bytes:
        if not going:
            wanted = f"{retention.min_free_bytes >> 20} MiB must stay free"
            msg = f"only {free >> 20} MiB are free, {wanted}, and there is no bundle left that may go"
            raise OSError(msg)
        going.pop().unlink(missing_ok=True)


def next_number(directory: Path) -> int:
    """Return a number larger than that of any bundle in the directory."""
    return max((_place(path)[0] for path in directory.glob("*.zip")), default=0) + 1


def _newest_first(directory: Path, *, failures: bool) -> list[Path]:
    found = [path for path in directory.glob("*.zip") if path.stem.endswith(f"_{FAILURE}") is failures]
    return sorted(found, key=_place, reverse=True)


def _place(path: Path) -> tuple[int, str]:
    """Return where a bundle stands among the others; one without a number is older than all that have one."""
    match = _NUMBER.match(path.name)
    return int(match[1]) if match else 0, path.name


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except FileNotFoundError:  # somebody tidied up by hand
        return None
