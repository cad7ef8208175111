"""How often may somebody try to log in?  So often in a time from one address, and for one name.

A stranger can thus not guess, and cannot keep somebody else out of the cell either: an address from which somebody has
logged in before does not suffer from what others try with that name.
"""

from __future__ import annotations

import ipaddress
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from enum import Enum
from typing import Final

__all__ = ["LoginLimit"]

WINDOW_S: Final = 300.0
MAX_KEYS: Final = 10_000
"""So many names and addresses are remembered at once, so that a flood of them takes no memory."""
SITE_BITS: Final = 64
"""Of an IPv6 address: who has one has all that begin like it (RFC 4291, section 2.5.4)."""


class _Of(Enum):
    """What is counted, and how many tries it has."""

    NAME_FROM_THERE = 5
    ADDRESS = 20
    NAME = 100


_Key = tuple[_Of, str, str]


class LoginLimit:
    """Counts tries that failed.  ``now_s`` is of the monotonic clock."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._failures: OrderedDict[_Key, deque[float]] = OrderedDict()
        self._known: OrderedDict[tuple[str, str], None] = OrderedDict()

    def begin(self, name: str, address: str) -> float:
        """Return how long to wait before a try; 0 if it may be made now.

        It then counts as failed until it has `succeeded`: of many that are made at once, no more get through.
        """
        name, site = name[:64], _site(address)
        keys = self._keys(name, site)
        wait_s = max(self._wait_s(key) for key in keys)
        if wait_s == 0.0:
            for key in keys:
                self._failures.setdefault(key, deque(maxlen=key[0].value)).append(self._now_s())
                self._failures.move_to_end(key)
            _bound(self._failures)
        return wait_s

    def succeeded(self, name: str, address: str) -> None:
        """Forget the failures of somebody; other names that were tried from there still count."""
        name, site = name[:64], _site(address)
        of_there = self._failures.get((_Of.ADDRESS, "", site))
        if of_there:
            of_there.pop()
        self._failures.pop((_Of.NAME_FROM_THERE, name, site), None)
        self._failures.pop((_Of.NAME, name, ""), None)
        self._known[name, site] = None
        self._known.move_to_end((name, site))
        _bound(self._known)

    def _keys(self, name: str, site: str) -> tuple[_Key, ...]:
        keys: tuple[_Key, ...] = ((_Of.NAME_FROM_THERE, name, site), (_Of.ADDRESS, "", site))
        return keys if (name, site) in self._known else (*keys, (_Of.NAME, name, ""))

    def _wait_s(self, key: _Key) -> float:
        times = self._failures.get(key)
        if times is None or len(times) < key[0].value:
            return 0.0
        return max(0.0, times[0] + WINDOW_S - self._now_s())


def _site(address: str) -> str:
    """Return what one computer cannot choose of its address."""
    try:
        known = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address[:64]
    if isinstance(known, ipaddress.IPv4Address):
        return str(known)
    if known.ipv4_mapped is not None:
        return str(known.ipv4_mapped)
    return str(ipaddress.ip_network((known, SITE_BITS), strict=False))


def _bound(kept: OrderedDict[_Key, deque[float]] | OrderedDict[tuple[str, str], None]) -> None:
    while len(kept) > MAX_KEYS:
        kept.popitem(last=False)
