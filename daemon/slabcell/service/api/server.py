"""How do clients reach the daemon?  A Unix socket with a mode and a group, and uvicorn behind it, with limits.

The limits are on connections, on the time until a request's head is there, on its size, and (in `endpoint`) on bodies.
Signals stay the daemon's own business.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import grp
import logging
import os
import socket
import stat
from collections.abc import AsyncGenerator, Generator
from pathlib import Path
from typing import Any, Final

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from slabcell.errors import ConfigurationError, UnavailableError
from slabcell.service.api.peer import peer_of

__all__ = ["listen", "serve"]

MAX_CONNECTIONS: Final = 64
HEAD_BYTES: Final = 16 << 10
HEAD_TIMEOUT_S: Final = 10.0
KEEP_ALIVE_S: Final = 10
STOP_TIMEOUT_S: Final = 2
PATH_BYTES: Final = 107
"""sun_path of unix(7), less its closing zero."""


def listen(path: Path, *, mode: int, group: str | None) -> socket.socket:
    """Return a socket that listens at ``path``, which a daemon that has died may have left behind.

    Raises ConfigurationError for a path or a group that cannot be, UnavailableError if another process listens there.
    """
    if len(os.fsencode(path)) > PATH_BYTES:
        msg = f"[api] socket {path}: is longer than the {PATH_BYTES} bytes that a Unix socket's path may have"
        raise ConfigurationError(msg)
    _clear(path)
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        before = os.umask(0o777 & ~mode)
        try:
            server.bind(os.fspath(path))
        finally:
            os.umask(before)
        path.chmod(mode)
        if group is not None:
            os.chown(path, -1, _group(group))
        server.listen(MAX_CONNECTIONS)
    except OSError as error:
        server.close()
        if error.errno == errno.EPERM:
            msg = f"[api] group {group}: the daemon's user may not give a file to it: add the user to that group"
            raise ConfigurationError(msg) from error
        msg = f"[api] socket {path}: cannot be made: {error.strerror}; does the directory exist, and may it be written?"
        raise ConfigurationError(msg) from error
    except BaseException:
        server.close()
        raise
    server.setblocking(False)  # noqa: FBT003 - the socket's own signature
    return server


def _group(name: str) -> int:
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError as error:
        msg = f"[api] group {name}: there is no such group on this computer"
        raise ConfigurationError(msg) from error


def _clear(path: Path) -> None:
    """Remove a socket to which nobody listens."""
    try:
        if not stat.S_ISSOCK(path.lstat().st_mode):
            msg = f"[api] socket {path}: is there and is no socket; name another path"
            raise ConfigurationError(msg)
    except FileNotFoundError:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except OSError as error:
            msg = f"[api] socket {path}: cannot be used: {error.strerror}"
            raise UnavailableError(msg) from error
    msg = f"[api] socket {path}: another process listens there; is a second cell running?"
    raise UnavailableError(msg)


@contextlib.asynccontextmanager
async def serve(app: ASGIApp, server_socket: socket.socket, path: Path) -> AsyncGenerator[None]:
    """Serve the app at the socket; in the end the socket's file is gone."""
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # bad requests are the clients' business, not the journal's
    config = uvicorn.Config(
        app,
        http=_Connection,
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=STOP_TIMEOUT_S,
        h11_max_incomplete_event_size=HEAD_BYTES,
    )
    server = _Server(config)
    serving = asyncio.create_task(server.serve(sockets=[server_socket]), name="slabcell-api")
    try:
        yield
    finally:
        server.should_exit = True
        await serving
        path.unlink(missing_ok=True)  # noqa: ASYNC240 - one call, in the end


class _Server(uvicorn.Server):
    """Leaves the signals alone."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield


class _Connection(H11Protocol):
    """One client.  Adds to uvicorn: who it is, a limit on clients, and a deadline for the head of each request."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]  (as uvicorn has it)
        self.app_state: dict[str, Any] = {
            "peer": peer_of(transport.get_extra_info("socket")),
            "abort": transport.abort,
        }
        super().connection_made(transport)
        if len(self.connections) > MAX_CONNECTIONS:
            transport.abort()
            return
        self._await_head()

    def data_received(self, data: bytes) -> None:
        if not self._busy:
            self._await_head()
        super().data_received(data)
        if self._busy:
            self._forget_deadline()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if not self._busy:
            self._forget_deadline()  # from here on uvicorn's own time for an idle connection counts

    def connection_lost(self, exc: Exception | None) -> None:
        self._forget_deadline()
        super().connection_lost(exc)

    @property
    def _busy(self) -> bool:
        """Whether a request is being answered."""
        return bool(self.cycle) and not self.cycle.response_complete

    def _await_head(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_TIMEOUT_S, self.transport.abort)

    def _forget_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
