"""What is an endpoint?  Its declaration, from which the route, the checks and the OpenAPI description are made."""

from __future__ import annotations

import asyncio
import dataclasses
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final, Generic, Literal, TypeVar

import structlog
from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Route

from slabcell.errors import SlabcellError
from slabcell.http_server import HEAD_BYTES, head_bytes
from slabcell.service.api.idempotency import KEY_HEADER, Once, check_key
from slabcell.service.api.peer import Peer
from slabcell.service.api.person import PERSON, PERSON_HEADER
from slabcell.service.api.problems import ProblemError, problem_of, respond

__all__ = ["Body", "Call", "Endpoint", "Query", "make_route"]

BODY_BYTES: Final = 64 << 10
BODY_TIMEOUT_S: Final = 10.0

Context = TypeVar("Context")
_log = structlog.get_logger(__name__)


class Query(BaseModel):
    """Parameters in the address, after the question mark."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Body(BaseModel):
    """The JSON object that a request carries."""

    model_config = ConfigDict(extra="forbid", frozen=True)


@dataclass(frozen=True, slots=True)
class Call(Generic[Context]):
    """One request, checked."""

    context: Context
    request: Request
    peer: Peer
    query: Any
    body: Any
    raw: bytes

    def number(self, name: str) -> int:
        """Return a whole number of the path.  Raises ProblemError 404: what has no such number is not there."""
        text = str(self.request.path_params[name])
        if not text.isascii() or not text.isdecimal() or len(text) > 18:
            raise ProblemError(404, f"{name} {text!r:.40} is no number")
        return int(text)

    def text(self, name: str) -> str:
        """Return a part of the path."""
        return str(self.request.path_params[name])


@dataclass(frozen=True, slots=True)
class Endpoint(Generic[Context]):
    """One thing that can be asked for or done.

    ``answer`` is the model of the JSON object that comes back, or the media type of what else does.  A ``raw`` body is
    handed on as bytes; ``raw`` is its media type.  Everything but GET needs an idempotency key, unless it is not
    ``kept``: what it leaves goes by itself, or is the same when it is done twice.
    """

    method: Literal["GET", "POST"]
    path: str
    summary: str
    handler: Callable[[Call[Context]], Awaitable[BaseModel | Response]]
    answer: type[BaseModel] | str
    tag: str
    query: type[Query] | None = None
    body: type[Body] | None = None
    raw: str | None = None
    body_bytes: int = BODY_BYTES
    problems: tuple[int, ...] = ()
    kept: bool = True

    @property
    def writes(self) -> bool:
        """Whether it takes a body, and may change something."""
        return self.method != "GET"

    @property
    def keyed(self) -> bool:
        """Whether it needs an idempotency key."""
        return self.writes and self.kept


def make_route(
    endpoint: Endpoint[Context], context: Context, once: Once, *, pause: Callable[[], Awaitable[None]]
) -> Route:
    """Return the route of an endpoint.  Whatever goes wrong in it is answered with a problem.

    Who only looks waits for a ``pause``; who wants something done does not.
    """

    async def serve(request: Request) -> Response:
        try:
            _check_head(request)
            if not endpoint.writes:
                await pause()
            query = _query(endpoint, request)
            raw = await _read_body(request, endpoint.body_bytes) if endpoint.writes else b""
            call = Call(context, request, _peer(request), query, _body(endpoint, request, raw), raw)
            if not endpoint.keyed:
                return await _answer(endpoint, call)
            key = check_key(request.headers.get(KEY_HEADER))
            return await once.answer(key, request, raw, lambda: _answer(endpoint, call))
        except ProblemError as error:
            return respond(error)
        except ClientDisconnect:
            return Response(status_code=HTTPStatus.BAD_REQUEST)  # nobody reads it

    return Route(endpoint.path, serve, methods=[endpoint.method])


def _check_head(request: Request) -> None:
    """Refuse a head that is too large; one that comes in one piece passes the parser's own limit."""
    found = head_bytes(request.scope)
    if found > HEAD_BYTES:
        raise ProblemError(431, f"the head has {found} bytes; at most {HEAD_BYTES} are taken")


def _peer(request: Request) -> Peer:
    """Return who asks, and for whom; the records of this request name both."""
    peer: Peer = request.state.peer
    person = request.headers.get(PERSON_HEADER)
    if person is None:
        return peer
    if not PERSON.fullmatch(person):
        raise ProblemError(422, f"{PERSON_HEADER}: {person!r:.60} is no name: 1 to 32 of a-z 0-9 . _ -")
    request.state.peer = peer = dataclasses.replace(peer, person=person)
    return peer


async def _answer(endpoint: Endpoint[Context], call: Call[Context]) -> Response:
    try:
        content = await endpoint.handler(call)
    except ProblemError as error:
        return respond(error)
    except SlabcellError as error:
        return respond(problem_of(error))
    except Exception as error:  # noqa: BLE001 - a client must not see a traceback, and the daemon goes on
        _log.exception("api request failed", path=endpoint.path)
        return respond(ProblemError(500, f"{type(error).__name__}: {error}"))
    if isinstance(content, Response):
        return content
    return Response(content.model_dump_json(by_alias=True), media_type="application/json")


def _query(endpoint: Endpoint[Context], request: Request) -> Query | None:
    names = [name for name, _ in request.query_params.multi_items()]
    if endpoint.query is None:
        if names:
            raise ProblemError(422, f"parameter {names[0]!r:.60} is not known here: there are none")
        return None
    if len(set(names)) < len(names):
        raise ProblemError(422, "a parameter is given twice")
    return _validated(endpoint.query, dict(request.query_params))


def _body(endpoint: Endpoint[Context], request: Request, raw: bytes) -> Body | None:
    if endpoint.raw is not None or endpoint.body is None:
        if raw and endpoint.raw is None:
            raise ProblemError(422, "this request takes no body")
        return None
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if raw and kind != "application/json":
        raise ProblemError(415, f"the body is {kind or 'of no type'!r:.60}; send application/json")
    try:
        content: object = json.loads(raw or b"{}")
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ProblemError(400, f"the body is no JSON: {error}") from error
    return _validated(endpoint.body, content)


_Model = TypeVar("_Model", bound=BaseModel)


def _validated(model: type[_Model], content: object) -> _Model:
    try:
        return model.model_validate(content)
    except ValidationError as error:
        found = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in found["loc"]) or "the body"
        fault = f"{where} = {found['input']!r:.60}: {found['msg']}"
        if found["type"] == "model_type":
            fault = f"{where} = {found['input']!r:.60}: must be a JSON object"
        elif found["type"] == "extra_forbidden":
            fault = f"{fault}; known are {', '.join(model.model_fields)}"
        raise ProblemError(422, fault) from error


async def _read_body(request: Request, limit: int) -> bytes:
    """Return the body, never more than the limit, and within the time."""
    claimed = request.headers.get("content-length", "0")
    if claimed.isdecimal() and int(claimed) > limit:
        raise ProblemError(413, f"the body has {claimed:.20} bytes; at most {limit} are taken")
    raw = bytearray()
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            async for chunk in request.stream():
                raw += chunk
                if len(raw) > limit:
                    raise ProblemError(413, f"the body is larger than {limit} bytes")
    except TimeoutError as error:
        raise ProblemError(408, f"the body was not there within {BODY_TIMEOUT_S:g} s") from error
    return bytes(raw)
