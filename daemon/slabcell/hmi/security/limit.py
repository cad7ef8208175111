"""How often may somebody try to log in?  So often in a time from one address, and for one name.

A stranger can thus not guess, and cannot easily keep somebody else out of the cell either.
"""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Final

__all__ = ["LoginLimit"]

_Key = tuple[str, str]

WINDOW_S: Final = 300.0
TRIES_OF_A_NAME_FROM_THERE: Final = 5
TRIES_OF_AN_ADDRESS: Final = 20
TRIES_OF_A_NAME: Final = 100
MAX_KEYS: Final = 10_000
"""So many names and addresses are remembered at once, so that a flood of them takes no memory."""


class LoginLimit:
    """Counts failures.  ``now_s`` is of the monotonic clock."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._failures: OrderedDict[_Key, deque[float]] = OrderedDict()

    def wait_s(self, name: str, address: str) -> float:
        """Return how long to wait before the next try; 0 if none."""
        return max(self._wait_s(key, most) for key, most in _limits(name, address))

    def failed(self, name: str, address: str) -> None:
        """Count a failure."""
        for key, most in _limits(name, address):
            times = self._failures.pop(key, None) or deque(maxlen=most)
            times.append(self._now_s())
            self._failures[key] = times
        while len(self._failures) > MAX_KEYS:
            self._failures.popitem(last=False)

    def succeeded(self, name: str, address: str) -> None:
        """Forget the failures of somebody."""
        for key, _ in _limits(name, address)[:2]:
            self._failures.pop(key, None)

    def _wait_s(self, key: _Key, most: int) -> float:
        times = self._failures.get(key)
        if times is None or len(times) < most:
            return 0.0
        return max(0.0, times[0] + WINDOW_S - self._now_s())


def _limits(name: str, address: str) -> tuple[tuple[_Key, int], ...]:
    name = name[:64]
    return (
        ((name, address), TRIES_OF_A_NAME_FROM_THERE),
        ((name, ""), TRIES_OF_A_NAME),
        (("", address), TRIES_OF_AN_ADDRESS),
    )
