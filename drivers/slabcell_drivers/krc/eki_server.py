"""Who may connect to a channel that is a server?  One client, and only until the time for it is over."""

import socket

from slabcell_drivers.krc.eki_transport import SocketTransport

__all__ = ["ServerSide"]


class ServerSide:
    """The listening side of a channel; ``deadline`` is when it gives up, on the clock of its owner."""

    def __init__(self, listener: socket.socket, deadline: float | None) -> None:
        self.listener = listener
        self.served = False
        """Whether a client has been accepted."""
        self._deadline = deadline

    def accept(self, *, refuse: bool) -> SocketTransport | None:
        """Return a client that has connected, if any; with ``refuse``, or after the first, it is turned away."""
        try:
            client, _ = self.listener.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return None
        if refuse or self.served:
            client.close()
            return None
        self.served = True
        return SocketTransport(client)

    def expired(self, now: float) -> bool:
        """Tell whether nobody came in time."""
        return self._deadline is not None and not self.served and now >= self._deadline

    def close(self) -> None:
        """Stop listening."""
        self.listener.close()
