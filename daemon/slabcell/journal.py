"""How does a log line reach systemd's journal with fields that one can search by?  Its datagrams, without a library.

Source: systemd, "Native Journal Protocol" (https://systemd.io/JOURNAL_NATIVE_PROTOCOL).
"""

import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Self

__all__ = ["JOURNAL_SOCKET", "Journal", "is_journal"]

JOURNAL_SOCKET: Final = Path("/run/systemd/journal/socket")
MAX_BYTES: Final = 60_000
"""Of one datagram; what is longer would need a file of its own, and no line of ours is worth that."""


class Journal:
    """The journal's socket, connected."""

    def __init__(self, sender: socket.socket) -> None:
        self._sender = sender

    @classmethod
    def connect(cls, path: Path = JOURNAL_SOCKET) -> Self | None:
        """Return the journal, or None where there is none."""
        sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            sender.connect(str(path))
        except OSError:
            sender.close()
            return None
        return cls(sender)

    def send(self, fields: Mapping[str, str]) -> bool:
        """Send one entry; return whether it could be sent.  A message that is too long loses its end."""
        entry = _encoded(fields)
        if len(entry) > MAX_BYTES:
            room = MAX_BYTES - (len(entry) - len(fields["MESSAGE"].encode()))
            cut = fields["MESSAGE"].encode()[: max(0, room)].decode("utf-8", "ignore")
            entry = _encoded({**fields, "MESSAGE": cut})
        try:
            self._sender.send(entry, socket.MSG_DONTWAIT)  # the cell does not wait for the journal
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Close the socket; may be called twice."""
        self._sender.close()


def is_journal(descriptor: int) -> bool:
    """Return whether what is written there goes to the journal, as systemd says in JOURNAL_STREAM."""
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    return (device, inode) == (str(status.st_dev), str(status.st_ino))


def _encoded(fields: Mapping[str, str]) -> bytes:
    """Return the fields as the protocol has them: a value with line feeds is preceded by its length."""
    parts: list[bytes] = []
    for name, value in fields.items():
        raw = value.encode("utf-8", "replace")
        if b"\n" in raw:
            parts.append(name.encode("ascii") + b"\n" + len(raw).to_bytes(8, "little") + raw + b"\n")
        else:
            parts.append(name.encode("ascii") + b"=" + raw + b"\n")
    return b"".join(parts)
