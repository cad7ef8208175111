"""Who is logged in?  Sessions with a random token, of which only the SHA-256 is kept.

The token is made at login and at no other time, so that a token known before the login is worth nothing.  A session
ends when it is not used, after its time, at logout, and with any change of its user.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.store import Store
from slabcell.hmi.security.users import User

__all__ = ["Session", "Sessions"]

TOKEN_BYTES: Final = 32
MAX_SESSIONS_OF_ONE: Final = 20
TOUCH_EVERY_S: Final = 30.0
"""How exactly it is noted when a session was used last."""


@dataclass(frozen=True, slots=True)
class Session:
    """One login.  ``csrf`` is what a form of it carries."""

    key: str
    user: User
    csrf: str
    address: str
    began_s: float
    used_s: float

    def is_form_of(self, token: str) -> bool:
        """Whether a form was made for this session."""
        return hmac.compare_digest(self.csrf.encode(), token.encode())


class Sessions:
    """All logins of one HMI.  ``now_s`` is the time of day in seconds: sessions outlive the process."""

    def __init__(
        self, store: Store, *, idle_s: float, lifetime_s: float, now_s: Callable[[], float] = time.time
    ) -> None:
        self._store = store
        self._idle_s, self._lifetime_s, self._now_s = idle_s, lifetime_s, now_s

    async def begin(self, user: User, address: str) -> str:
        """Begin a session; return its token, which the browser keeps."""
        token, csrf, now_s = secrets.token_urlsafe(TOKEN_BYTES), secrets.token_urlsafe(TOKEN_BYTES), self._now_s()
        key = _key(token)

        await self._store.run(
            lambda db: db.execute(
                "INSERT INTO sessions VALUES (?, ?, ?, ?, ?, ?)", (key, user.name, csrf, address, now_s, now_s)
            )
        )
        await self._store.run(
            lambda db: db.execute(
                "DELETE FROM sessions WHERE used_s < ? OR began_s < ? OR user = ? AND token_sha256 NOT IN"
                " (SELECT token_sha256 FROM sessions WHERE user = ? ORDER BY began_s DESC LIMIT ?)",
                (now_s - self._idle_s, now_s - self._lifetime_s, user.name, user.name, MAX_SESSIONS_OF_ONE),
            )
        )
        return token

    async def find(self, token: str) -> Session | None:
        """Return the session of a token, and note its use; None if it has ended, or never was."""
        return await self._find(_key(token)) if 0 < len(token) <= 100 else None

    async def alive(self, session: Session) -> bool:
        """Return whether a session stands, and note its use."""
        return await self._find(session.key) is not None

    async def _find(self, key: str) -> Session | None:
        row = await self._store.run(
            lambda db: db.execute(
                "SELECT user, role, created_utc, csrf, address, began_s, used_s FROM sessions"
                " JOIN users ON name = user WHERE token_sha256 = ?",
                (key,),
            ).fetchone()
        )
        if row is None:
            return None
        name, role, created, csrf, address, began_s, used_s = row
        now_s = self._now_s()
        if not began_s <= now_s + 60 or now_s > began_s + self._lifetime_s or now_s > used_s + self._idle_s:
            await self._remove(key)
            return None
        if now_s - used_s > TOUCH_EVERY_S:
            await self._store.run(
                lambda db: db.execute("UPDATE sessions SET used_s = ? WHERE token_sha256 = ?", (now_s, key))
            )
        return Session(key, User(name, Role.of(role), created), csrf, address, began_s, used_s)

    async def end(self, session: Session) -> None:
        """End a session."""
        await self._remove(session.key)

    async def _remove(self, key: str) -> None:
        await self._store.run(lambda db: db.execute("DELETE FROM sessions WHERE token_sha256 = ?", (key,)))


def _key(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
