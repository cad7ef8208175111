"""Who did what?  Every write that came over the pages, allowed or not, with its outcome.

What strangers try has a room of its own in it, and so many lines a minute: they cannot push out what users did, nor
wear out the disk.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from slabcell.hmi.security.store import Store

__all__ = ["Audit", "AuditLine"]

KEPT: Final = 50_000
KEPT_OF_STRANGERS: Final = 5_000
STRANGERS_A_MINUTE: Final = 120
PRUNE_EVERY: Final = 256
SECRET: Final = frozenset({"password", "again", "token", "csrf", "old"})
MAX_TEXT: Final = 500


@dataclass(frozen=True, slots=True)
class AuditLine:
    """One write."""

    id: int
    at_utc: str
    user: str
    role: str
    address: str
    action: str
    content: str
    status: int
    outcome: str


class Audit:
    """The log of one HMI; the oldest of many lines go."""

    def __init__(self, store: Store, now_s: Callable[[], float] = time.monotonic) -> None:
        self._store = store
        self._now_s = now_s
        self._strangers: deque[float] = deque(maxlen=STRANGERS_A_MINUTE)
        self._left_out = 0

    async def add(
        self, user: str, role: str, address: str, action: str, content: Mapping[str, str], status: int, outcome: str
    ) -> None:
        """Add a line; what is secret in the content is left out.

        Of those without a user, what is beyond so many a minute is counted in the next line.
        """
        if not user:
            now_s = self._now_s()
            if len(self._strangers) == STRANGERS_A_MINUTE and now_s < self._strangers[0] + 60.0:
                self._left_out += 1
                return
            self._strangers.append(now_s)
            if self._left_out:
                outcome, self._left_out = f"{outcome} ({self._left_out} more before this)", 0
        shown = {name: value[:100] for name, value in content.items() if name not in SECRET}
        values = (
            datetime.now(UTC).isoformat(timespec="milliseconds"),
            *(user[:64], role, address, action[:200], json.dumps(shown)[:MAX_TEXT], status, outcome[:MAX_TEXT]),
        )

        def work(db: sqlite3.Connection) -> None:
            row = db.execute(
                "INSERT INTO audit (at_utc, user, role, address, action, content, status, outcome)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
                values,
            ).lastrowid
            if row is not None and row % PRUNE_EVERY == 0:
                for whose, kept in (("user != ''", KEPT), ("user = ''", KEPT_OF_STRANGERS)):
                    db.execute(
                        f"DELETE FROM audit WHERE id IN (SELECT id FROM audit WHERE {whose}"  # noqa: S608 - ours
                        " ORDER BY id DESC LIMIT -1 OFFSET ?)",
                        (kept,),
                    )

        await self._store.run(work)

    async def page(self, *, before: int = 1 << 60, limit: int = 100) -> list[AuditLine]:
        """Return the newest lines with an id below ``before``."""
        rows = await self._store.run(
            lambda db: db.execute(
                "SELECT id, at_utc, user, role, address, action, content, status, outcome FROM audit"
                " WHERE id < ? ORDER BY id DESC LIMIT ?",
                (before, limit),
            ).fetchall()
        )
        return [AuditLine(*row) for row in rows]
