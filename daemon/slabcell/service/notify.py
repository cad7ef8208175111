"""How does the daemon tell systemd how it is?  The datagrams of sd_notify(3), without a library.

Source: sd_notify(3), sd_watchdog_enabled(3).
"""

import os
import socket

import structlog

__all__ = ["notify", "watchdog_interval_s"]

_log = structlog.get_logger(__name__)


def notify(message: str) -> bool:
    """Send a state such as ``READY=1``; return whether a supervisor was told.  Nobody to tell is no error."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address or address[0] not in "/@":
        return False
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.settimeout(1.0)
            sender.sendto(message.encode("utf-8"), address.replace("@", "\0", 1) if address[0] == "@" else address)
    except OSError as error:
        _log.warning("supervisor not told", message=message, error=str(error))
        return False
    return True


def watchdog_interval_s() -> float | None:
    """Return how often the supervisor wants a sign of life, a third of its limit; None if it wants none."""
    limit = os.environ.get("WATCHDOG_USEC", "")
    owner = os.environ.get("WATCHDOG_PID", str(os.getpid()))
    if not limit.isdecimal() or owner != str(os.getpid()):
        return None
    return max(0.05, int(limit) / 3e6)
