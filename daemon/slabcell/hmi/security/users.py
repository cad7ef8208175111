"""Who is known?  Users with a role and a password, of which only the Argon2id hash is kept.

Parameters are those of RFC 9106, section 4, for machines with little memory (64 MiB, three passes), which are the
defaults of argon2-cffi.  At most two hashes are computed at once, so that a flood of logins cannot take the memory.
"""

from __future__ import annotations

import asyncio
import re
import sqlite3
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from slabcell.errors import SlabcellError
from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.store import Store

__all__ = ["MAX_PASSWORD", "MIN_PASSWORD", "User", "UserError", "Users"]

MIN_PASSWORD: Final = 10
MAX_PASSWORD: Final = 200
MAX_USERS: Final = 200
HASHES_AT_ONCE: Final = 2
NAME: Final = re.compile(r"[a-z][a-z0-9._-]{1,31}")


class UserError(SlabcellError):
    """A user cannot be made or changed like this; the message says why.  ``key`` is the pages' word for it."""

    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


@dataclass(frozen=True, slots=True)
class User:
    """Somebody who may log in."""

    name: str
    role: Role
    created_utc: str


class Users:
    """All users of one HMI."""

    def __init__(self, store: Store, hasher: PasswordHasher | None = None) -> None:
        self._store = store
        self._hasher = hasher or PasswordHasher()
        self._turns = asyncio.Semaphore(HASHES_AT_ONCE)
        self._nobody = ""

    async def all(self) -> list[User]:
        """Return everybody, by name."""
        rows = await self._store.run(
            lambda db: db.execute("SELECT name, role, created_utc FROM users ORDER BY name").fetchall()
        )
        return [User(name, Role.of(role), created) for name, role, created in rows]

    async def exist(self) -> bool:
        """Return whether there is anybody."""
        return await self._store.run(lambda db: db.execute("SELECT 1 FROM users LIMIT 1").fetchone()) is not None

    async def get(self, name: str) -> User | None:
        """Return one user."""
        return next((user for user in await self.all() if user.name == name), None)

    async def add(self, name: str, role: Role, password: str) -> User:
        """Add somebody.  Raises UserError."""
        if not NAME.fullmatch(name):
            raise UserError("bad_name", "a name has 2 to 32 of a-z 0-9 . _ - and begins with a letter")
        users = await self.all()
        if len(users) >= MAX_USERS:
            raise UserError("too_many", f"there are {MAX_USERS} users already; remove one first")
        hashed = await self._hash(password)
        user = User(name, role, datetime.now(UTC).isoformat(timespec="seconds"))
        try:
            await self._store.run(
                lambda db: db.execute(
                    "INSERT INTO users VALUES (?, ?, ?, ?)", (name, role.word, hashed, user.created_utc)
                )
            )
        except sqlite3.IntegrityError as error:
            raise UserError("exists", f"there is a user {name} already") from error
        return user

    async def set_role(self, name: str, role: Role) -> None:
        """Give somebody another role; logins end.  Raises UserError: one admin has to stay."""
        statement = "UPDATE users SET role = ? WHERE name = ?"
        await self._change(name, statement, (role.word, name), admin_stays=role is Role.ADMIN)

    async def set_password(self, name: str, password: str) -> None:
        """Give somebody another password; logins end.  Raises UserError."""
        hashed = await self._hash(password)
        statement = "UPDATE users SET password_hash = ? WHERE name = ?"
        await self._change(name, statement, (hashed, name), admin_stays=True)

    async def remove(self, name: str) -> None:
        """Remove somebody; logins end.  Raises UserError: one admin has to stay."""
        await self._change(name, "DELETE FROM users WHERE name = ?", (name,), admin_stays=False)

    async def _change(self, name: str, statement: str, values: tuple[str, ...], *, admin_stays: bool) -> None:
        """Change one user and end the logins; with ``admin_stays`` False not the only admin, whoever asks at once."""

        def work(db: sqlite3.Connection) -> int | None:
            db.execute("BEGIN IMMEDIATE")
            try:
                admins = db.execute("SELECT name FROM users WHERE role = ?", (Role.ADMIN.word,)).fetchall()
                changed = None
                if admin_stays or admins != [(name,)]:
                    changed = db.execute(statement, values).rowcount
                    db.execute("DELETE FROM sessions WHERE user = ?", (name,))
            except BaseException:
                db.execute("ROLLBACK")
                raise
            db.execute("COMMIT")
            return changed

        changed = await self._store.run(work)
        if changed is None:
            raise UserError("last_admin", f"{name} is the only admin: make another one first")
        if changed == 0:
            raise UserError("unknown", f"there is no user {name:.40}")

    async def _hash(self, password: str) -> str:
        if not MIN_PASSWORD <= len(password) <= MAX_PASSWORD:
            raise UserError("bad_password", f"a password has {MIN_PASSWORD} to {MAX_PASSWORD} characters")
        async with self._turns:
            return await asyncio.to_thread(self._hasher.hash, password)

    async def check(self, name: str, password: str) -> User | None:
        """Return the user if the password is right.  A name that is not known takes as long as one that is."""
        row = await self._store.run(
            lambda db: db.execute(
                "SELECT name, role, created_utc, password_hash FROM users WHERE name = ?", (name[:64],)
            ).fetchone()
        )
        async with self._turns:
            if not self._nobody:
                self._nobody = await asyncio.to_thread(self._hasher.hash, "nobody has this password")
            right = await asyncio.to_thread(self._verify, row[3] if row else self._nobody, password[:MAX_PASSWORD])
        return User(row[0], Role.of(row[1]), row[2]) if row and right else None

    def _verify(self, hashed: str, password: str) -> bool:
        try:
            return self._hasher.verify(hashed, password)
        except (VerificationError, InvalidHashError):
            return False
