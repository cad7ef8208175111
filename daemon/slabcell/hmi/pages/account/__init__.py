"""Log in, log out, make the first admin; choose language and colours."""

from __future__ import annotations

import math
import secrets
from http import HTTPStatus

from starlette.responses import Response

from slabcell.hmi.guard import cookie_name
from slabcell.hmi.live import LOGIN_ENDED
from slabcell.hmi.route import Page, get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.security.users import User, UserError
from slabcell.hmi.visit import Refusal, Visit
from slabcell.hmi.words import LANGUAGES

__all__ = ["PAGE"]

YEAR_S = 365 * 86_400


async def _login(visit: Visit) -> Response:
    if visit.session is not None:
        return visit.go("/")
    if await _is_first_start(visit):
        return visit.go("/first")
    return _form(visit)


def _form(visit: Visit, *, status: int = 200, problem: str = "", name: str = "") -> Response:
    return visit.page("login.html", status=status, problem=problem, name=name, next=_next(visit))


def _next(visit: Visit) -> str:
    """Return where to go after the login: a path of ours, never another host."""
    wanted = visit.text("next", most=500)
    safe = wanted.startswith("/") and not wanted.startswith(("//", "/\\")) and wanted.isprintable()
    return wanted if safe else "/"


async def _try_login(visit: Visit) -> Response:
    name, address = visit.text("name", most=64), visit.address
    wait_s = visit.hmi.limit.begin(name, address)
    if wait_s > 0:
        visit.outcome = "refused: too many failures"
        problem = visit.words("too_many_tries", minutes=math.ceil(wait_s / 60))
        response = _form(visit, status=HTTPStatus.TOO_MANY_REQUESTS, problem=problem, name=name)
        response.headers["retry-after"] = str(math.ceil(wait_s))
        return response
    user = await visit.hmi.users.check(name, visit.text("password", most=1000))
    if user is None:
        visit.outcome = "wrong name or password"
        return _form(visit, status=HTTPStatus.FORBIDDEN, problem=visit.words("wrong"), name=name)
    visit.hmi.limit.succeeded(name, address)
    visit.outcome = f"{name} logged in"
    return await _begin(visit, user, _next(visit))


async def _begin(visit: Visit, user: User, path: str) -> Response:
    """Begin a session with a new token, whatever the browser had before."""
    if visit.session is not None:
        await visit.hmi.sessions.end(visit.session)
    token = await visit.hmi.sessions.begin(user, visit.address)
    visit.session = await visit.hmi.sessions.find(token)  # whose doing this was, for the audit log
    response = visit.go(path)
    response.set_cookie(
        cookie_name(visit.hmi), token, httponly=True, samesite="strict", secure=visit.hmi.secure, path="/"
    )
    return response


async def _logout(visit: Visit) -> Response:
    if visit.session is not None:
        await visit.hmi.sessions.end(visit.session)
        visit.hmi.link.tell(LOGIN_ENDED)
    visit.outcome = "logged out"
    response = visit.go("/login")
    response.delete_cookie(cookie_name(visit.hmi), path="/", httponly=True, samesite="strict", secure=visit.hmi.secure)
    return response


async def _is_first_start(visit: Visit) -> bool:
    """Return whether nobody can log in yet; the token is worth nothing once somebody can, however that came."""
    if visit.hmi.first_token and await visit.hmi.users.exist():
        visit.hmi.first_token = ""
    return bool(visit.hmi.first_token)


async def _first(visit: Visit) -> Response:
    if not await _is_first_start(visit):
        return visit.go("/login")
    return visit.page("first.html", problem="", name="")


async def _make_first(visit: Visit) -> Response:
    hmi, name = visit.hmi, visit.text("name", most=64)
    if not await _is_first_start(visit):
        raise Refusal(HTTPStatus.NOT_FOUND, "refused.no_page")

    def again(status: int, problem: str) -> Response:
        visit.outcome = problem
        return visit.page("first.html", status=status, problem=problem, name=name)

    token = hmi.first_token
    if (wait_s := hmi.limit.begin("", visit.address)) > 0:
        return again(HTTPStatus.TOO_MANY_REQUESTS, visit.words("too_many_tries", minutes=math.ceil(wait_s / 60)))
    if not secrets.compare_digest(visit.text("token").strip().encode(), token.encode()):
        return again(HTTPStatus.FORBIDDEN, visit.words("wrong_token"))
    hmi.limit.succeeded("", visit.address)
    if visit.text("password") != visit.text("again"):
        return again(HTTPStatus.UNPROCESSABLE_ENTITY, visit.words("differ"))
    hmi.first_token = ""  # of two that come at once, one is the first
    try:
        user = await hmi.users.add(name, Role.ADMIN, visit.text("password"))
    except BaseException as error:
        hmi.first_token = token
        if isinstance(error, UserError):
            return again(HTTPStatus.UNPROCESSABLE_ENTITY, visit.words(f"user.{error.key}"))
        raise
    visit.outcome = f"first admin {name} made"
    return await _begin(visit, user, "/")


async def _prefer(visit: Visit) -> Response:
    """Keep language and colours in the browser: an operator's panel is used by many."""
    language, theme = visit.text("language"), visit.text("theme")
    back = _next(visit)
    response = visit.go(back)
    for name, value, known in (
        ("language", language, {*LANGUAGES}),
        ("theme", theme, {"light", "dark", "auto"}),
    ):
        if value in known:
            response.set_cookie(
                f"slabcell-{name}", value, max_age=YEAR_S, httponly=True, samesite="strict", secure=visit.hmi.secure
            )
    return response


PAGE = Page(
    "account",
    "/login",
    Role.VIEWER,
    None,
    (
        get("/login", _login, None),
        post("/login", _try_login, None),
        post("/logout", _logout, None),
        get("/first", _first, None),
        post("/first", _make_first, None),
        post("/preferences", _prefer, None),
    ),
)
