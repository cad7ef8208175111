"""How do bytes travel between the emulated controller and its peer?  Non-blocking TCP, behind a small protocol.

The protocol is the place where faults of a link are put in: see `slabcell_drivers.krc.eki_faults`.
"""

import socket
from contextlib import suppress
from typing import Protocol

__all__ = ["Link", "LinkClosedError", "PlainLink", "SocketTransport", "Transport", "connect", "listen"]

RECEIVE_BYTES = 65536
MAX_UNSENT_BYTES = 1024 * 1024


class LinkClosedError(Exception):
    """The connection is gone: the peer closed it, or it broke."""


class Transport(Protocol):
    """One connection.  Nothing here waits."""

    def readable_fd(self) -> int | None:
        """Return the descriptor to wait on for received bytes, if there is one."""
        ...

    def send(self, data: bytes) -> None:
        """Take bytes to be sent.  Raises LinkClosedError."""
        ...

    def receive(self) -> bytes:
        """Return what has arrived, empty if nothing has.  Raises LinkClosedError."""
        ...

    def pump(self) -> bool:
        """Send what could not be sent before; return whether something moved.  Raises LinkClosedError."""
        ...

    @property
    def peer_answers_ping(self) -> bool:
        """Whether the peer's host can be reached."""
        ...

    def close(self) -> None:
        """Close the connection; twice is once."""
        ...


class Link(Protocol):
    """What connections run over."""

    @property
    def reachable(self) -> bool:
        """Whether a new connection can be made."""
        ...

    def wrap(self, transport: Transport) -> Transport:
        """Return the connection as it runs over this link."""
        ...


class PlainLink:
    """A link without faults."""

    reachable = True

    def wrap(self, transport: Transport) -> Transport:
        """Return the connection itself."""
        return transport


class SocketTransport:
    """A connected TCP socket."""

    def __init__(self, connected: socket.socket) -> None:
        connected.settimeout(0.0)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connected
        self._unsent = bytearray()

    def readable_fd(self) -> int | None:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    def send(self, data: bytes) -> None:
        """Send at once what the system takes, keep the rest for `pump`."""
        if len(self._unsent) + len(data) > MAX_UNSENT_BYTES:
            msg = f"the peer does not read: {len(self._unsent)} bytes unsent, at most {MAX_UNSENT_BYTES} are kept"
            raise LinkClosedError(msg)
        self._unsent += data
        self.pump()

    def receive(self) -> bytes:
        """Return what has arrived."""
        try:
            data = self._socket.recv(RECEIVE_BYTES)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            raise LinkClosedError(f"the connection broke: {error}") from error
        if not data:
            msg = "the peer closed the connection"
            raise LinkClosedError(msg)
        return data

    def pump(self) -> bool:
        """Send what is kept."""
        if not self._unsent:
            return False
        try:
            sent = self._socket.send(self._unsent)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError as error:
            raise LinkClosedError(f"the connection broke: {error}") from error
        del self._unsent[:sent]
        return sent > 0

    @property
    def peer_answers_ping(self) -> bool:
        """Always: a socket on this machine has no cable."""
        return True

    def close(self) -> None:
        """Close the socket."""
        with suppress(OSError):  # the peer may have closed before
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def connect(address: tuple[str, int], timeout_s: float) -> SocketTransport:
    """Return a connection to a server, waiting for it at most so long.  Raises OSError, TimeoutError among them."""
    client = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        client.settimeout(timeout_s)
        client.connect(address)
    except BaseException:
        client.close()
        raise
    return SocketTransport(client)


def listen(address: tuple[str, int]) -> socket.socket:
    """Return a non-blocking listening socket.  Raises OSError."""
    server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.settimeout(0.0)
        server.bind(address)
        server.listen(2)
    except BaseException:
        server.close()
        raise
    return server
