"""Which application serves the pages?  Every route of the table, behind its role, its checks and the audit log."""

from __future__ import annotations

import asyncio
import traceback
from collections.abc import Awaitable, Callable
from http import HTTPStatus
from typing import Final
from urllib.parse import parse_qsl, quote

import structlog
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from slabcell.errors import SlabcellError, TemporaryError, UnavailableError
from slabcell.hmi.context import Hmi
from slabcell.hmi.guard import FORM_TOKEN, HEADERS, TLS_HEADERS, cookie_name, is_known_host, is_own_origin
from slabcell.hmi.live import live_endpoint
from slabcell.hmi.pages import PAGES
from slabcell.hmi.route import HmiRoute, Page
from slabcell.hmi.static_files import static_files
from slabcell.hmi.visit import Refusal, Visit
from slabcell.http_server import HEAD_BYTES, head_bytes

__all__ = ["make_app"]

BODY_TIMEOUT_S: Final = 10.0
MAX_FIELDS: Final = 200
AGAIN_S: Final = 5
"""After so long a browser asks again for a page that the cell could not answer."""

_log = structlog.get_logger(__name__)


def make_app(hmi: Hmi) -> ASGIApp:
    """Return the application of an HMI."""
    routes = [_route(hmi, page, route) for page in hmi.pages for route in page.routes]
    app = Starlette(
        routes=[
            *routes,
            Route("/static/{version}/{name:path}", _static, methods=["GET"]),
            WebSocketRoute("/live", live_endpoint(hmi)),
        ],
        exception_handlers={HTTPException: _not_there(hmi)},
    )
    return _Shell(app, hmi)


class _Shell:
    """Around everything: unknown hosts and large heads are refused, and every answer carries the headers."""

    def __init__(self, app: ASGIApp, hmi: Hmi) -> None:
        self._app, self._hmi = app, hmi
        self._headers = [
            (name.encode(), value.encode())
            for name, value in {**HEADERS, **(TLS_HEADERS if hmi.secure else {})}.items()
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            await self._http(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                there = {name for name, _ in message["headers"]}
                message["headers"] = [
                    *message["headers"],
                    *(line for line in self._headers if line[0] not in there),
                ]
            await send(message)

        if head_bytes(scope) > HEAD_BYTES:
            text = self._hmi.words_of({}, "base")("refused.too_large", most=HEAD_BYTES >> 10)
            status = HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE
        elif not is_known_host(self._hmi, Request(scope).headers):
            text, status = self._hmi.words_of({}, "base")("refused.host"), HTTPStatus.MISDIRECTED_REQUEST
        else:
            await self._app(scope, receive, with_headers)
            return
        await PlainTextResponse(f"{text}\n", status)(scope, receive, with_headers)


def _route(hmi: Hmi, page: Page, route: HmiRoute) -> Route:
    async def serve(request: Request) -> Response:
        visit = await _visit(hmi, page, request)
        try:
            response = await _answer(visit, route)
        except ClientDisconnect:
            return Response(status_code=HTTPStatus.BAD_REQUEST)  # nobody reads it
        except Exception as error:  # noqa: BLE001 - the HMI goes on; a traceback without values holds no secrets
            _log.error("page failed", path=request.url.path, traceback="".join(traceback.format_exception(error)))
            response = visit.problem(HTTPStatus.INTERNAL_SERVER_ERROR, visit.words("refused.failed"))
        if route.method == "POST" and (route.logged or response.status_code >= HTTPStatus.BAD_REQUEST):
            user = visit.session.user if visit.session else None
            await hmi.audit.add(
                *(user.name if user else "", user.role.word if user else "", visit.address),
                *(request.url.path, visit.form, response.status_code, visit.outcome),
            )
        return response

    return Route(route.path, serve, methods=[route.method])


async def _visit(hmi: Hmi, page: Page, request: Request) -> Visit:
    token = request.cookies.get(cookie_name(hmi), "")
    session = await hmi.sessions.find(token) if token else None
    theme = request.cookies.get("slabcell-theme", "")
    words = hmi.words_of(request.cookies, page.name)
    return Visit(hmi, request, page.name, words, theme if theme in {"light", "dark"} else "auto", session)


async def _answer(visit: Visit, route: HmiRoute) -> Response:
    """Return what the handler answers, or why it was not asked."""
    try:
        await _admit(visit, route)
        return await route.handler(visit)
    except Refusal as refusal:
        text = visit.words(refusal.key, **refusal.values)
        return _refused(visit, refusal.status, text)
    except SlabcellError as error:
        unavailable = isinstance(error, (UnavailableError, TemporaryError))
        status = HTTPStatus.SERVICE_UNAVAILABLE if unavailable else HTTPStatus.CONFLICT
        response = _refused(visit, status, visit.words.said(str(error)))
        visit.outcome = str(error)  # the log has one language; its page says it in the reader's
        return response


async def _admit(visit: Visit, route: HmiRoute) -> None:
    """Raise Refusal unless this request may be answered."""
    request = visit.request
    writes = route.method == "POST"
    if writes and not is_own_origin(visit.hmi, request.headers):
        raise Refusal(HTTPStatus.FORBIDDEN, "refused.origin")
    if route.role is not None:
        if visit.session is None:
            raise Refusal(HTTPStatus.UNAUTHORIZED, "refused.login")
        if visit.session.user.role < route.role:
            raise Refusal(HTTPStatus.FORBIDDEN, "refused.role", role=visit.words(f"role.{route.role.word}"))
    if not writes:
        return
    visit.raw = await _body(request, route.body_bytes)
    if route.raw is None:
        visit.form = _form(request, visit.raw)
    elif _media_type(request) != route.raw:
        raise Refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "refused.media_type", wanted=route.raw)
    token = request.headers.get(FORM_TOKEN) or visit.form.get("csrf", "")
    if visit.session is not None and not visit.session.is_form_of(token):
        raise Refusal(HTTPStatus.FORBIDDEN, "refused.form")


def _refused(visit: Visit, status: int, text: str) -> Response:
    if status == HTTPStatus.UNAUTHORIZED and visit.request.method == "GET":
        here = visit.request.url.path + (f"?{visit.request.url.query}" if visit.request.url.query else "")
        if visit.wants_fragment:
            return Response(status_code=status, headers={"hx-redirect": "/login"})
        return visit.go(f"/login?next={quote(here, safe='')}" if here != "/" else "/login")
    if visit.request.method == "POST" and visit.wants_fragment:
        return visit.failed(status, text)
    visit.outcome = text
    response = visit.problem(status, text)
    if status == HTTPStatus.SERVICE_UNAVAILABLE and visit.request.method == "GET" and not visit.wants_fragment:
        response.headers["refresh"] = str(AGAIN_S)  # a panel on the wall comes back by itself
    return response


def _media_type(request: Request) -> str:
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def _form(request: Request, raw: bytes) -> dict[str, str]:
    """Return the fields of a form; the last one counts where a name comes twice."""
    if not raw:
        return {}
    if _media_type(request) != "application/x-www-form-urlencoded":
        raise Refusal(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "refused.no_form")
    try:
        fields = parse_qsl(
            raw.decode("utf-8"), keep_blank_values=True, strict_parsing=True, errors="strict", max_num_fields=MAX_FIELDS
        )
    except ValueError as error:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.form") from error
    return dict(fields)


async def _body(request: Request, limit: int) -> bytes:
    """Return the body, never more than the limit, and within the time.  Raises Refusal."""
    claimed = request.headers.get("content-length", "0")
    if claimed.isdecimal() and int(claimed[:20]) > limit:
        raise Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "refused.too_large", most=limit >> 10)
    raw = bytearray()
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            async for chunk in request.stream():
                raw += chunk
                if len(raw) > limit:
                    raise Refusal(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "refused.too_large", most=limit >> 10)
    except TimeoutError as error:
        raise Refusal(HTTPStatus.REQUEST_TIMEOUT, "refused.too_slow") from error
    return bytes(raw)


async def _static(request: Request) -> Response:
    files = static_files()
    file = files.files.get(request.path_params["name"])
    if file is None or request.path_params["version"] != files.version:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    headers = {"cache-control": "public, max-age=31536000, immutable"}
    return Response(file.content, media_type=file.media_type, headers=headers)


def _not_there(hmi: Hmi) -> Callable[[Request, Exception], Awaitable[Response]]:
    async def answer(request: Request, error: Exception) -> Response:
        status = error.status_code if isinstance(error, HTTPException) else HTTPStatus.INTERNAL_SERVER_ERROR
        visit = await _visit(hmi, PAGES[0], request)
        return visit.problem(status, visit.words("refused.no_page" if status == HTTPStatus.NOT_FOUND else "refused.no"))

    return answer
