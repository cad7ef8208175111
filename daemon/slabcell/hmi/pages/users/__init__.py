"""Who may log in, as what, and what was done over the pages?"""

from __future__ import annotations

from http import HTTPStatus

from starlette.responses import Response

from slabcell.hmi.live import LOGIN_ENDED
from slabcell.hmi.route import Page, get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.users import UserError
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["PAGE"]

AUDIT_LINES = 100


async def _page(visit: Visit) -> Response:
    lines = await visit.hmi.audit.page(before=visit.number("before") or 1 << 60, limit=AUDIT_LINES + 1)
    return visit.page(
        "users.html",
        users=await visit.hmi.users.all(),
        roles=tuple(Role),
        lines=lines[:AUDIT_LINES],
        before=lines[AUDIT_LINES - 1].id if len(lines) > AUDIT_LINES else None,
    )


async def _list(visit: Visit) -> Response:
    return visit.fragment("list.html", users=await visit.hmi.users.all(), roles=tuple(Role))


def _role(visit: Visit) -> Role:
    try:
        return Role.of(visit.text("role"))
    except ValueError as error:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no") from error


def _new_password(visit: Visit) -> str:
    if visit.text("password") != visit.text("again"):
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "differ")
    return visit.text("password")


def _not_done(visit: Visit, error: UserError) -> Response:
    return visit.failed(HTTPStatus.UNPROCESSABLE_ENTITY, visit.words(f"user.{error.key}"))


async def _add(visit: Visit) -> Response:
    role, name = _role(visit), visit.text("name")
    try:
        await visit.hmi.users.add(name, role, _new_password(visit))
    except UserError as error:
        return _not_done(visit, error)
    return visit.done(visit.words("added", name=name), "users")


async def _set_role(visit: Visit) -> Response:
    role, name = _role(visit), visit.text("name")
    try:
        await visit.hmi.users.set_role(name, role)
    except UserError as error:
        return _not_done(visit, error)
    return visit.done(visit.words("changed", name=name), "users", LOGIN_ENDED)


async def _set_password(visit: Visit) -> Response:
    name = visit.text("name")
    try:
        await visit.hmi.users.set_password(name, _new_password(visit))
    except UserError as error:
        return _not_done(visit, error)
    return visit.done(visit.words("changed", name=name), "users", LOGIN_ENDED)


async def _remove(visit: Visit) -> Response:
    name = visit.text("name")
    try:
        await visit.hmi.users.remove(name)
    except UserError as error:
        return _not_done(visit, error)
    return visit.done(visit.words("removed", name=name), "users", LOGIN_ENDED)


PAGE = Page(
    "users",
    "/users",
    Role.ADMIN,
    90,
    (
        get("/users", _page, Role.ADMIN),
        get("/users/list", _list, Role.ADMIN),
        post("/users/add", _add, Role.ADMIN),
        post("/users/role", _set_role, Role.ADMIN),
        post("/users/password", _set_password, Role.ADMIN),
        post("/users/remove", _remove, Role.ADMIN),
    ),
)
