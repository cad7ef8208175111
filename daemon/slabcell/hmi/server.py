"""How does the HMI live as a process?  Users' file, link to the daemon, one TCP port, an orderly end."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import socket
import ssl
from collections.abc import AsyncGenerator, Callable
from typing import Final

import structlog

from slabcell.errors import ConfigurationError, UnavailableError
from slabcell.hmi.app import make_app
from slabcell.hmi.context import Hmi, HmiOptions
from slabcell.hmi.pages import PAGES
from slabcell.http_server import HttpConnection, serving
from slabcell.service.notify import notify

__all__ = ["Opened", "run_hmi", "serve_hmi"]

MAX_CONNECTIONS: Final = 200
MAX_OF_ONE_ADDRESS: Final = 100
"""A browser opens six for files, and one for each page's live link."""
KEEP_ALIVE_S: Final = 15
LIVE_MESSAGE_BYTES: Final = 1024
FIRST_TOKEN_BYTES: Final = 9

Opened = Callable[[str, str], None]
"""Is told the address to open, and the first-start token, which is empty where there are users."""

_log = structlog.get_logger(__name__)


async def run_hmi(options: HmiOptions, opened: Opened) -> None:
    """Serve the pages until SIGTERM or SIGINT; SIGHUP renews the certificate.

    Raises ConfigurationError, UnavailableError.
    """
    stopping = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopping.set)
    try:
        async with serve_hmi(options) as (hmi, address):
            loop.add_signal_handler(signal.SIGHUP, _load_again, hmi)
            opened(address, hmi.first_token)
            notify(f"READY=1\nSTATUS=serving {address}")
            await stopping.wait()
            notify("STOPPING=1")
    finally:
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            loop.remove_signal_handler(number)


@contextlib.asynccontextmanager
async def serve_hmi(options: HmiOptions) -> AsyncGenerator[tuple[Hmi, str]]:
    """Serve the pages until the end of the block; give the HMI and the address to open."""
    hmi = Hmi.of(options, PAGES)
    hmi.tls = _tls(options)
    listening = _listen(options)
    async with contextlib.AsyncExitStack() as stack:
        stack.callback(listening.close)
        stack.push_async_callback(hmi.api.close)
        stack.push_async_callback(hmi.store.close)
        await hmi.store.open()
        if not await hmi.users.exist():
            hmi.first_token = secrets.token_urlsafe(FIRST_TOKEN_BYTES)
        await stack.enter_async_context(hmi.link.running())
        await stack.enter_async_context(
            serving(
                make_app(hmi),
                listening,
                connection=_Connection,
                name="slabcell-hmi",
                keep_alive_s=KEEP_ALIVE_S,
                tls=hmi.tls,
                ws="websockets-sansio",
                ws_max_size=LIVE_MESSAGE_BYTES,
                ws_per_message_deflate=False,
            )
        )
        stack.callback(hmi.stopping.set)
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


class _Connection(HttpConnection):
    """One browser's, or a stranger's."""

    max_connections = MAX_CONNECTIONS
    max_of_one_address = MAX_OF_ONE_ADDRESS


def _tls(options: HmiOptions) -> ssl.SSLContext | None:
    """Return what certificate and key make of a connection; None without.  Raises ConfigurationError."""
    if options.certificate is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _load(context, options)
    return context


def _load(context: ssl.SSLContext, options: HmiOptions) -> None:
    """Read certificate and key, which connections have from now on.  Raises ConfigurationError."""
    certificate, key = options.certificate or "", options.private_key

    def no_password() -> str:  # else OpenSSL asks for one at the terminal
        msg = "it asks for a password: store the key without one, readable by this user only"
        raise ValueError(msg)

    try:
        for one in (ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER), context):  # tried first: both are used, or none
            one.load_cert_chain(certificate, key, no_password)
    except (OSError, ValueError) as error:
        msg = f"[hmi] certificate {certificate}, private_key {key}: cannot be used: {error}"
        raise ConfigurationError(msg) from error


def _load_again(hmi: Hmi) -> None:
    """Read certificate and key again, where there are any; what cannot be used leaves those that were."""
    if hmi.tls is None:
        return
    try:
        _load(hmi.tls, hmi.options)
    except ConfigurationError as error:
        _log.error("certificate not renewed", problem=str(error))
    else:
        _log.info("certificate read again", certificate=str(hmi.options.certificate))
