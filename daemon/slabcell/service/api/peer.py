"""Who is at the other end of the socket?  The kernel's word for it: process, user and group of the client.

Source: unix(7), SO_PEERCRED.
"""

from __future__ import annotations

import pwd
import socket
import struct
from dataclasses import dataclass
from typing import Final

__all__ = ["NOBODY", "Peer", "peer_of"]

_CREDENTIALS: Final = struct.Struct("3i")


@dataclass(frozen=True, slots=True)
class Peer:
    """A client's process and user, as they were when it connected."""

    pid: int
    uid: int
    gid: int
    person: str = ""
    """For whom it asks, as it says."""

    def __str__(self) -> str:
        """Name the user, for the audit, and behind whom it stands."""
        try:
            user = pwd.getpwuid(self.uid).pw_name
        except KeyError:
            user = f"uid {self.uid}"
        return f"{self.person} (through {user})" if self.person else user


NOBODY: Final = Peer(0, 65_534, 65_534)
"""Where the kernel does not say."""


def peer_of(connection: socket.socket | None) -> Peer:
    """Return who connected."""
    if connection is None or connection.family != socket.AF_UNIX:
        return NOBODY
    return Peer(*_CREDENTIALS.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)))
