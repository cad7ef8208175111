"""Guesses are counted whatever they look like, an admin stays, nobody pushes out the record of what was done."""

import asyncio
import sqlite3
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from argon2 import PasswordHasher

from slabcell.errors import UnavailableError
from slabcell.hmi.security.audit import KEPT_OF_STRANGERS, PRUNE_EVERY, STRANGERS_A_MINUTE, Audit
from slabcell.hmi.security.limit import WINDOW_S, LoginLimit
from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.sessions import Sessions
from slabcell.hmi.security.store import Store
from slabcell.hmi.security.users import UserError, Users

pytestmark = pytest.mark.unit

PASSWORD = "correct horse battery"  # noqa: S105 - of users that live as long as a test


class Clock:
    """Time that a test moves."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    opened = Store(tmp_path / "hmi.sqlite")
    await opened.open()
    yield opened
    await opened.close()


@pytest.fixture
def users(store: Store) -> Users:
    """Users whose hashes cost nothing: what they hold is not what is tested here."""
    return Users(store, PasswordHasher(time_cost=1, memory_cost=8, parallelism=1))


# Guessing


def tries(limit: LoginLimit, address: str, names: list[str]) -> int:
    """Return how many tries were admitted, of which none succeeds."""
    return sum(limit.begin(name, address) == 0.0 for name in names)


def test_a_name_is_tried_so_often_from_one_address_until_the_time_is_over() -> None:
    clock = Clock()
    limit = LoginLimit(clock)
    assert tries(limit, "192.0.2.1", ["anna"] * 9) == 5
    assert limit.begin("anna", "192.0.2.1") == pytest.approx(WINDOW_S)
    clock.now_s += WINDOW_S
    assert tries(limit, "192.0.2.1", ["anna"] * 9) == 5


@pytest.mark.parametrize("first", ["", "bert", "x" * 64], ids=["no name", "a name", "a long name"])
def test_many_names_are_counted_by_their_address_whatever_was_tried_first(first: str) -> None:
    limit = LoginLimit(Clock())
    admitted = tries(limit, "192.0.2.1", [first] * 3)
    assert admitted + tries(limit, "192.0.2.1", [f"name{number}" for number in range(50)]) == 20


def test_who_has_one_address_of_ipv6_has_all_that_begin_like_it() -> None:
    limit = LoginLimit(Clock())
    addresses = [f"2001:db8:0:1::{number:x}" for number in range(40)]
    assert sum(tries(limit, address, ["anna"]) for address in addresses) == 5
    assert tries(limit, "2001:db8:0:2::1", ["anna"]) == 1
    assert tries(limit, "::ffff:192.0.2.1", ["bert"] * 3) + tries(limit, "192.0.2.1", ["bert"] * 3) == 5


def test_strangers_everywhere_do_not_keep_out_who_has_logged_in_from_there_before() -> None:
    limit = LoginLimit(Clock())
    assert limit.begin("anna", "192.0.2.1") == 0.0
    limit.succeeded("anna", "192.0.2.1")
    everywhere = [f"198.51.100.{number}" for number in range(200)]
    assert sum(tries(limit, address, ["anna"]) for address in everywhere) == 100
    assert limit.begin("anna", "192.0.2.1") == 0.0
    assert limit.begin("anna", "192.0.2.2") > 0.0


def test_a_login_of_ones_own_does_not_make_up_for_guesses_at_others() -> None:
    limit = LoginLimit(Clock())
    admitted = 0
    for number in range(50):
        admitted += tries(limit, "192.0.2.1", [f"name{number}"])
        if limit.begin("mallory", "192.0.2.1") == 0.0:
            limit.succeeded("mallory", "192.0.2.1")
    assert admitted <= 20


# Users


async def test_of_two_admins_who_remove_each_other_at_once_one_stays(users: Users) -> None:
    for name in ("anna", "bert"):
        await users.add(name, Role.ADMIN, PASSWORD)
    done = await asyncio.gather(users.remove("anna"), users.set_role("bert", Role.VIEWER), return_exceptions=True)
    assert [type(error) for error in done if error] == [UserError]
    assert [user.role for user in await users.all()].count(Role.ADMIN) == 1


@pytest.mark.parametrize("change", ["role", "password", "remove"])
async def test_a_change_of_somebody_ends_the_logins(store: Store, users: Users, change: str) -> None:
    await users.add("anna", Role.ADMIN, PASSWORD)
    bert = await users.add("bert", Role.OPERATOR, PASSWORD)
    sessions = Sessions(store, idle_s=60.0, lifetime_s=600.0)
    token = await sessions.begin(bert, "192.0.2.1")
    assert await sessions.find(token)
    match change:
        case "role":
            await users.set_role("bert", Role.VIEWER)
        case "password":
            await users.set_password("bert", f"{PASSWORD} 2")
        case _:
            await users.remove("bert")
            await users.add("bert", Role.VIEWER, PASSWORD)
    assert await sessions.find(token) is None


async def test_a_session_ends_unused_and_after_its_time(store: Store, users: Users) -> None:
    clock = Clock()
    anna = await users.add("anna", Role.VIEWER, PASSWORD)
    sessions = Sessions(store, idle_s=100.0, lifetime_s=250.0, now_s=clock)
    token = await sessions.begin(anna, "192.0.2.1")
    for _ in range(3):
        clock.now_s += 80.0
        assert await sessions.find(token)
    clock.now_s += 20.0
    assert await sessions.find(token) is None
    token = await sessions.begin(anna, "192.0.2.1")
    clock.now_s += 101.0
    assert await sessions.find(token) is None


async def test_somebody_has_so_many_sessions_and_the_oldest_goes(store: Store, users: Users) -> None:
    clock = Clock()
    anna = await users.add("anna", Role.VIEWER, PASSWORD)
    sessions = Sessions(store, idle_s=600.0, lifetime_s=600.0, now_s=clock)
    tokens: list[str] = []
    for _ in range(25):
        clock.now_s += 1.0
        tokens.append(await sessions.begin(anna, "192.0.2.1"))
    assert [await sessions.find(token) is not None for token in tokens] == [False] * 5 + [True] * 20


# The file


async def test_a_file_of_users_that_others_may_read_is_closed_to_them(tmp_path: Path) -> None:
    path = tmp_path / "hmi.sqlite"
    path.touch(mode=0o644)
    path.chmod(0o664)
    store = Store(path)
    await store.open()
    assert path.stat().st_mode & 0o777 == 0o600
    await store.close()


@pytest.mark.parametrize("content", [b"not a database", b"SQLite format 3\0" + b"\xff" * 4096, None])
async def test_a_file_that_is_damaged_or_of_a_later_version_is_refused_and_left_alone(
    tmp_path: Path, content: bytes | None
) -> None:
    path = tmp_path / "hmi.sqlite"
    if content is None:
        db = sqlite3.connect(path)
        db.execute("PRAGMA application_id=1936484469")
        db.execute("PRAGMA user_version=99")
        db.close()
        content = path.read_bytes()
    path.write_bytes(content)
    store = Store(path)
    with pytest.raises(UnavailableError, match=r"hmi\.sqlite: cannot be used"):
        await store.open()
    await store.close()
    assert path.read_bytes() == content


# The record


async def tried(audit: Audit, times: int, clock: Clock, *, apart_s: float) -> None:
    for _ in range(times):
        clock.now_s += apart_s
        await audit.add("", "", "192.0.2.1", "/login", {"name": "root", "password": "x"}, 403, "wrong")


async def test_strangers_do_not_push_out_what_users_did(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    audit = Audit(store, clock)
    await store.run(lambda db: db.execute("PRAGMA synchronous=OFF"))
    await audit.add("anna", "admin", "192.0.2.1", "/users/remove", {"name": "bert"}, 200, "bert is removed")
    monkeypatch.setattr("slabcell.hmi.security.audit.KEPT_OF_STRANGERS", 100)
    monkeypatch.setattr("slabcell.hmi.security.audit.KEPT", 100)
    await tried(audit, 2 * PRUNE_EVERY, clock, apart_s=1.0)
    lines = await audit.page(limit=1000)
    assert lines[-1].user == "anna"
    assert len(lines) <= 101 + PRUNE_EVERY
    assert KEPT_OF_STRANGERS < 50_000


async def test_a_flood_of_strangers_is_counted_not_listed(store: Store) -> None:
    clock = Clock()
    audit = Audit(store, clock)
    await tried(audit, STRANGERS_A_MINUTE + 30, clock, apart_s=0.001)
    assert len(await audit.page(limit=1000)) == STRANGERS_A_MINUTE
    await audit.add("anna", "admin", "192.0.2.1", "/run/stop", {}, 200, "stopped")
    clock.now_s += 60.0
    await tried(audit, 1, clock, apart_s=0.0)
    newest, of_anna, *_ = await audit.page(limit=5)
    assert of_anna.user == "anna", "a user's doing is always listed"
    assert newest.outcome == "wrong (30 more before this)"
    assert "password" not in newest.content
