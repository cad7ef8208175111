"""Was this very request made before?  A write carries a key, and is done once; asked again, it gets the same answer.

What was done is kept on disk, so that a client may repeat its request after a restart of the daemon as well.  The key
is written down before the work begins: of a request that was cut short nobody knows how far it got, and that is what
is answered, instead of doing it twice.  Source: IETF draft "The Idempotency-Key HTTP Header Field".
"""

from __future__ import annotations

import asyncio
import hashlib
import re
from collections.abc import Awaitable, Callable
from typing import Final

import structlog
from starlette.requests import Request
from starlette.responses import Response

from slabcell.service.api.problems import ProblemError
from slabcell.service.history import Answered, History

__all__ = ["KEY_HEADER", "Once", "check_key"]

KEY_HEADER: Final = "idempotency-key"
_KEY: Final = re.compile(r'"?([A-Za-z0-9._:\-]{8,64})"?')

_log = structlog.get_logger("slabcell.audit")


def check_key(header: str | None) -> str:
    """Return the key of a header.  Raises ProblemError 400 if there is none, or it is none."""
    if header is None:
        raise ProblemError(
            400, "the header Idempotency-Key is missing: give each new write one of its own, such as a UUID"
        )
    found = _KEY.fullmatch(header.strip())
    if found is None:
        raise ProblemError(400, "the header Idempotency-Key must be 8 to 64 letters, digits, '.', '_', ':' or '-'")
    return found[1]


class Once:
    """Does each write once.  Requests with one key wait for each other."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._turns: dict[str, tuple[asyncio.Lock, int]] = {}

    async def answer(self, key: str, request: Request, raw: bytes, work: Callable[[], Awaitable[Response]]) -> Response:
        """Return what ``work`` returns, or what it returned before for this key.

        Raises ProblemError 422 if the key was used for another request, and 409 if that one was cut short.
        """
        # A client that goes away does not undo what was begun.
        task = asyncio.create_task(self._in_turn(key, request, raw, work), name="slabcell-api-write")
        return await asyncio.shield(task)

    async def _in_turn(
        self, key: str, request: Request, raw: bytes, work: Callable[[], Awaitable[Response]]
    ) -> Response:
        lock, waiting = self._turns.get(key, (asyncio.Lock(), 0))
        self._turns[key] = (lock, waiting + 1)
        try:
            async with lock:
                return await self._once(key, request, raw, work)
        finally:
            lock, waiting = self._turns.pop(key)
            if waiting > 1:
                self._turns[key] = (lock, waiting - 1)

    async def _once(self, key: str, request: Request, raw: bytes, work: Callable[[], Awaitable[Response]]) -> Response:
        what = f"{request.method} {request.url.path}?{request.url.query}".encode() + b"\0" + raw
        fingerprint = hashlib.sha256(what).hexdigest()
        known = await self._history.request_begins(key, fingerprint, str(request.state.peer), request.url.path)
        if known is not None:
            return _repeat(known, fingerprint)
        response = await work()
        content = bytes(response.body)
        await self._history.request_ended(key, response.status_code, response.media_type or "", content)
        _log.info(
            "api write",
            path=request.url.path,
            user=str(request.state.peer),
            pid=request.state.peer.pid,
            status=response.status_code,
        )
        return response


def _repeat(known: Answered, fingerprint: str) -> Response:
    if known.fingerprint != fingerprint:
        raise ProblemError(422, "this Idempotency-Key was used for another request: give each new write its own")
    if known.status is None:
        raise ProblemError(
            409,
            "a request with this key was cut short, and may have been carried out: look before you ask with a new key",
        )
    return Response(
        known.body,
        known.status,
        media_type=known.media_type or None,
        headers={"idempotent-replayed": "true"},
    )
