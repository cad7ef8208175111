"""How is HTTP served to whoever comes?  By uvicorn, with times and counts that it does not have of its own.

A request's head has to come within a time, what is sent has to be read within a time, and so many connections may be
open at once, in all and from one address.  A client that keeps to none of it holds one connection for a while, and
keeps nobody else out.  Signals stay the process's own business.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections.abc import AsyncGenerator, Generator
from typing import Any, ClassVar, Final

import uvicorn
from starlette.types import ASGIApp, Scope
from uvicorn.protocols.http.h11_impl import H11Protocol

__all__ = ["HEAD_BYTES", "HttpConnection", "head_bytes", "serving"]

HEAD_BYTES: Final = 16 << 10
"""Of a head that comes in pieces; one that comes whole is as large as one read of the kernel at the most."""
STOP_TIMEOUT_S: Final = 2


def head_bytes(scope: Scope) -> int:
    """Return how large the head of a request is that has come: address and fields."""
    fields: list[tuple[bytes, bytes]] = scope["headers"]
    address = len(scope["raw_path"]) + len(scope["query_string"])
    return address + sum(len(name) + len(value) for name, value in fields)


class HttpConnection(H11Protocol):
    """One client.  Raises nothing: who is too slow, or one too many, is cut off."""

    max_connections: ClassVar[int] = 64
    max_of_one_address: ClassVar[int] = 64
    head_timeout_s: ClassVar[float] = 10.0
    read_timeout_s: ClassVar[float] = 30.0
    """How long a client may leave unread what the kernel's buffers do not hold."""

    _head: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]  (as uvicorn has it)
        """Begin to wait for a request, or cut off who is one too many."""
        super().connection_made(transport)
        if len(self.connections) > self.max_connections or self._of_this_address() > self.max_of_one_address:
            self.connections.discard(self)  # it takes nobody's room until it is gone
            transport.abort()
            return
        self._await_head()

    def _of_this_address(self) -> int:
        """Return how many connections this client's address has; 0 for a client without an address."""
        if self.client is None:
            return 0
        known: list[tuple[str, int] | None] = [getattr(other, "client", None) for other in self.connections]
        return sum(other is not None and other[0] == self.client[0] for other in known)

    def data_received(self, data: bytes) -> None:
        """Read what came; the time for a head runs until a request is whole."""
        if not self._busy:
            self._await_head()
        super().data_received(data)
        if self._busy:
            self._head = _forget(self._head)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection over, with no time of ours running on."""
        self._head = _forget(self._head)
        super().handle_websocket_upgrade(event)

    def on_response_complete(self) -> None:
        """Begin to wait for the next request."""
        super().on_response_complete()
        if not self._busy:
            self._head = _forget(self._head)  # from here on uvicorn's own time for an idle connection counts

    def pause_writing(self) -> None:
        """Wait, not for ever, until the client reads."""
        self._unread = self.loop.call_later(self.read_timeout_s, self.transport.abort)
        super().pause_writing()

    def resume_writing(self) -> None:
        """Go on writing."""
        self._unread = _forget(self._unread)
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the times."""
        self._head, self._unread = _forget(self._head), _forget(self._unread)
        super().connection_lost(exc)

    @property
    def _busy(self) -> bool:
        """Whether a request is being answered."""
        return bool(self.cycle) and not self.cycle.response_complete

    def _await_head(self) -> None:
        if self._head is None:
            self._head = self.loop.call_later(self.head_timeout_s, self.transport.abort)


def _forget(timer: asyncio.TimerHandle | None) -> None:
    if timer is not None:
        timer.cancel()


@contextlib.asynccontextmanager
async def serving(
    app: ASGIApp,
    listening: socket.socket,
    *,
    connection: type[HttpConnection],
    name: str,
    keep_alive_s: int,
    tls: ssl.SSLContext | None = None,
    **more: Any,
) -> AsyncGenerator[None]:
    """Serve an application at a socket until the end of the block; ``more`` are settings of uvicorn."""
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # bad requests are the clients' business, not the journal's
    config = uvicorn.Config(
        app,
        http=connection,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=keep_alive_s,
        timeout_graceful_shutdown=STOP_TIMEOUT_S,
        h11_max_incomplete_event_size=HEAD_BYTES,
        **more,
    )
    config.load()
    config.ssl = tls
    server = _Server(config)
    task = asyncio.create_task(server.serve(sockets=[listening]), name=name)
    try:
        yield
    finally:
        server.should_exit = True
        await task


class _Server(uvicorn.Server):
    """Leaves the signals alone."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield
