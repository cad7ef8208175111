"""`slabcell hmi user`, `slabcell hmi audit`: users of the web pages and what they did, without the pages.

They work on the file of users itself, beside a running HMI or without one, with the rights of who may write it.
"""

import asyncio
import json
import sys
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from rich.table import Table
from rich.text import Text

from slabcell.cli.talk import make_console
from slabcell.errors import UsageError
from slabcell.hmi.security.audit import Audit
from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.store import Store
from slabcell.hmi.security.users import Users
from slabcell.hmi.settings import read_options

__all__ = ["audit_command", "user_app"]

user_app = typer.Typer(no_args_is_help=True, help="List, add, change and remove users of the web pages.")

Config = Annotated[Path, typer.Option("--config", metavar="FILE", help="The cell's configuration.")]
Name = Annotated[str, typer.Argument(metavar="NAME", help="Who.")]
RoleName = Annotated[str, typer.Option("--role", help="viewer, operator, engineer or admin.")]
CONFIG = Path("/etc/slabcell/cell.toml")

_T = TypeVar("_T")


def _with_store(config: Path, work: Callable[[Store], Awaitable[_T]]) -> _T:
    async def run() -> _T:
        store = Store(read_options(config).state / "hmi.sqlite")
        await store.open()
        try:
            return await work(store)
        finally:
            await store.close()

    return asyncio.run(run())


def _password() -> str:
    """Return a password from standard input: asked for twice at a terminal, else its first line."""
    if sys.stdin.isatty():
        return str(typer.prompt("Password", hide_input=True, confirmation_prompt=True))
    return sys.stdin.readline().rstrip("\n")


def _role(name: str) -> Role:
    try:
        return Role.of(name)
    except ValueError as error:
        raise UsageError(str(error)) from error


@user_app.command("list")
def list_command(
    config: Config = CONFIG,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show who may log in."""
    users = _with_store(config, lambda store: Users(store).all())
    if as_json:
        shown = [{"name": user.name, "role": user.role.word, "created": user.created_utc} for user in users]
        typer.echo(json.dumps({"schema": "slabcell.hmi-users/1", "users": shown}))
        return
    for user in users:
        typer.echo(f"{user.name:32} {user.role.word:10} {user.created_utc}")


@user_app.command("add")
def add_command(name: Name, role: RoleName = "viewer", config: Config = CONFIG) -> None:
    """Add somebody; the password is read from standard input."""
    wanted, password = _role(role), _password()
    _with_store(config, lambda store: Users(store).add(name, wanted, password))
    typer.echo(f"{name} may log in as {wanted.word}")


@user_app.command("role")
def role_command(name: Name, role: RoleName, config: Config = CONFIG) -> None:
    """Give somebody another role; logins end."""
    wanted = _role(role)
    _with_store(config, lambda store: Users(store).set_role(name, wanted))
    typer.echo(f"{name} is {wanted.word} now")


@user_app.command("password")
def password_command(name: Name, config: Config = CONFIG) -> None:
    """Give somebody another password, read from standard input; logins end."""
    password = _password()
    _with_store(config, lambda store: Users(store).set_password(name, password))
    typer.echo(f"{name} has another password")


@user_app.command("remove")
def remove_command(name: Name, config: Config = CONFIG) -> None:
    """Remove somebody; logins end."""
    _with_store(config, lambda store: Users(store).remove(name))
    typer.echo(f"{name} is removed")


def audit_command(
    config: Config = CONFIG,
    limit: Annotated[int, typer.Option("--limit", min=1, max=1000, help="At most so many lines.")] = 50,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Show what was done over the pages, the newest first."""
    lines = _with_store(config, lambda store: Audit(store).page(limit=limit))
    if as_json:
        typer.echo(json.dumps({"schema": "slabcell.hmi-audit/1", "lines": [asdict(line) for line in lines]}))
        return
    table = Table("time", "user", "from", "action", "status", "outcome")
    for line in lines:
        cells = (line.at_utc, line.user, line.address, line.action, str(line.status), line.outcome)
        table.add_row(*map(_inert, cells))
    make_console().print(table)


def _inert(text: str) -> Text:
    """Return what a stranger may have written as text that does nothing to a terminal."""
    return Text("".join(sign if sign.isprintable() else "\N{REPLACEMENT CHARACTER}" for sign in text))
