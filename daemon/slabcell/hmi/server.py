"""How does the HMI live as a process?  Users' file, link to the daemon, one TCP port, an orderly end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import signal
import socket
import ssl
from collections.abc import AsyncGenerator, Callable, Generator
from typing import Final

import structlog
import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from slabcell.errors import ConfigurationError, UnavailableError
from slabcell.hmi.app import make_app
from slabcell.hmi.context import Hmi, HmiOptions
from slabcell.hmi.pages import PAGES
from slabcell.service.notify import notify

__all__ = ["Opened", "run_hmi", "serve_hmi"]

MAX_CONNECTIONS: Final = 200
HEAD_BYTES: Final = 16 << 10
KEEP_ALIVE_S: Final = 15
STOP_TIMEOUT_S: Final = 2
LIVE_MESSAGE_BYTES: Final = 1024
FIRST_TOKEN_BYTES: Final = 9

Opened = Callable[[str, str], None]
"""Is told the address to open, and the first-start token, which is empty where there are users."""

_log = structlog.get_logger(__name__)


async def run_hmi(options: HmiOptions, opened: Opened) -> None:
    """Serve the pages until SIGTERM or SIGINT.  Raises ConfigurationError, UnavailableError."""
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    try:
        async with serve_hmi(options) as (hmi, address):
            opened(address, hmi.first_token)
            notify(f"READY=1\nSTATUS=serving {address}")
            await stopping.wait()
            notify("STOPPING=1")
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)


@contextlib.asynccontextmanager
async def serve_hmi(options: HmiOptions) -> AsyncGenerator[tuple[Hmi, str]]:
    """Serve the pages until the end of the block; give the HMI and the address to open."""
    hmi = Hmi.of(options, PAGES)
    listening = _listen(options)
    async with contextlib.AsyncExitStack() as stack:
        stack.callback(listening.close)
        stack.push_async_callback(hmi.api.close)
        stack.push_async_callback(hmi.store.close)
        await hmi.store.open()
        if not await hmi.users.exist():
            hmi.first_token = secrets.token_urlsafe(FIRST_TOKEN_BYTES)
        await stack.enter_async_context(hmi.link.running())
        await stack.enter_async_context(_serving(hmi, listening))
        host, port = listening.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        address = f"{'https' if hmi.secure else 'http'}://{shown}:{port}/"
        _log.info("serving", address=address)
        yield hmi, address


def _listen(options: HmiOptions) -> socket.socket:
    try:
        family, kind, _, _, address = socket.getaddrinfo(
            options.host, options.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        server = socket.socket(family, kind)
    except OSError as error:
        msg = f"[hmi] host {options.host}: is no address of this computer: {error.strerror}"
        raise ConfigurationError(msg) from error
    try:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind(address)
        server.listen(MAX_CONNECTIONS)
    except OSError as error:
        server.close()
        msg = f"[hmi] {options.host}:{options.port}: cannot be listened on: {error.strerror}; is another HMI running?"
        raise UnavailableError(msg) from error
    server.setblocking(False)  # noqa: FBT003 - the socket's own signature
    return server


@contextlib.asynccontextmanager
async def _serving(hmi: Hmi, listening: socket.socket) -> AsyncGenerator[None]:
    logging.getLogger("uvicorn").setLevel(logging.ERROR)  # bad requests are the clients' business, not the journal's
    options = hmi.options
    config = uvicorn.Config(
        make_app(hmi),
        http=H11Protocol,
        ws="websockets-sansio",
        ws_max_size=LIVE_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        limit_concurrency=MAX_CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=STOP_TIMEOUT_S,
        h11_max_incomplete_event_size=HEAD_BYTES,
        ssl_certfile=options.certificate,
        ssl_keyfile=options.private_key,
    )
    try:
        config.load()
    except (OSError, ssl.SSLError) as error:
        msg = f"[hmi] certificate {options.certificate}, private_key {options.private_key}: cannot be used: {error}"
        raise ConfigurationError(msg) from error
    if config.ssl is not None:
        config.ssl.minimum_version = ssl.TLSVersion.TLSv1_2
    server = _Server(config)
    serving = asyncio.create_task(server.serve(sockets=[listening]), name="slabcell-hmi")
    try:
        yield
    finally:
        hmi.stopping.set()
        server.should_exit = True
        await serving


class _Server(uvicorn.Server):
    """Leaves the signals alone."""

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield
