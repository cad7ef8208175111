"""How do requests reach the cell, whatever happens to their connection?  One at a time, and each is finished.

A request that is under way when its connection is lost is not cancelled, because the cell may be half way through its
ledger: the link lets it finish and drops its answer, and only then the next connection's request is handed on.
"""

import asyncio
import dataclasses
import socket
from collections.abc import Callable
from typing import Generic, TypeVar

import structlog

from slabcell_drivers.robot.message import printable
from slabcell_drivers.robot.protocol import Answer, Handler, Request

__all__ = ["HANDLER_FAILED_CODE", "Answering", "notice_dead_peer"]

HANDLER_FAILED_CODE = 1801
"""Entry of the error catalogue for "the cell itself failed while it answered"."""
HANDLER_FAILED_TEXT = "slabcell: internal error, see the cell's log"

Sent = TypeVar("Sent")
"""What goes to the robot: an answer in the form of its link."""

_log = structlog.get_logger(__name__)


class Answering(Generic[Sent]):
    """Asks the handler, one request after the other over all connections of a link.

    ``encode`` writes an answer as the link does, and raises ValueError for one that cannot be sent.
    """

    def __init__(self, handler: Handler, encode: Callable[[Answer], Sent]) -> None:
        self._handler = handler
        self._encode = encode
        self._turn = asyncio.Lock()

    async def answer(self, request: Request) -> Sent:
        """Return what to send: the handler's answer, encoded, or an error number if it raises or cannot be sent.

        Not to be cancelled once the handler is asked; a link that stops waits for it.  No task of its own: whoever
        sends goes on as the handler ends.
        """
        async with self._turn:
            try:
                answer = await self._handler(request)
            except Exception:  # noqa: BLE001 - the robot must get an answer, whatever the cell's fault is
                _log.exception("robot.handler_failed", request=request.type.name, sequence=request.sequence)
                return self._encode(_failure(request, HANDLER_FAILED_TEXT))
            try:
                return self._encode(dataclasses.replace(answer, acknowledges=request.sequence))
            except ValueError as error:
                _log.error("robot.answer_unsendable", request=request.type.name, error=str(error))
                return self._encode(_failure(request, printable(str(error))))


def _failure(request: Request, text: str) -> Answer:
    return Answer(request.session, request.sequence, request.sequence, HANDLER_FAILED_CODE, message=text)


def notice_dead_peer(sock: socket.socket) -> None:
    """Have the kernel notice a dead peer in two seconds: a probe after one second of silence, one to answer it."""
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 1)
    # Also when an answer of ours stays unacknowledged, which keep-alive alone does not cover.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 2000)
