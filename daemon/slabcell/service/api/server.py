"""How do clients reach the daemon?  A Unix socket with a mode and a group, and an HTTP server behind it, with limits.

The limits are on connections and their times (`slabcell.http_server`), and on bodies (in `endpoint`).
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import grp
import os
import socket
import stat
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any, Final

from starlette.types import ASGIApp

from slabcell.errors import ConfigurationError, UnavailableError
from slabcell.http_server import HttpConnection, serving
from slabcell.service.api.peer import peer_of

__all__ = ["listen", "serve"]

MAX_CONNECTIONS: Final = 64
KEEP_ALIVE_S: Final = 10
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
    try:
        async with serving(
            app, server_socket, connection=_Connection, name="slabcell-api", keep_alive_s=KEEP_ALIVE_S, ws="none"
        ):
            yield
    finally:
        path.unlink(missing_ok=True)  # noqa: ASYNC240 - one call, in the end


class _Connection(HttpConnection):
    """One client.  Adds who it is."""

    max_connections = MAX_CONNECTIONS

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Ask the kernel who it is."""
        self.app_state: dict[str, Any] = {
            "peer": peer_of(transport.get_extra_info("socket")),
            "abort": transport.abort,
        }
        super().connection_made(transport)
