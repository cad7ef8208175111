"""What is kept for a while only?  Uploads and previews: bounded in number, in size and in time."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from typing import Generic, TypeVar

__all__ = ["Expiring"]

_T = TypeVar("_T")


class Expiring(Generic[_T]):
    """Things by name.  The oldest goes when there are too many, or too many bytes; each goes by itself after a time.

    Used in the event loop.
    """

    def __init__(self, *, number: int, total_bytes: int, kept_s: float) -> None:
        self.kept_s = kept_s
        self._number = number
        self._total_bytes = total_bytes
        self._items: OrderedDict[str, tuple[_T, int, asyncio.TimerHandle]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._items)

    @property
    def bytes(self) -> int:
        """How much is kept."""
        return sum(size for _, size, _ in self._items.values())

    def add(self, name: str, item: _T, size: int) -> None:
        """Keep a thing of so many bytes; one of the same name is replaced."""
        self.drop(name)
        timer = asyncio.get_running_loop().call_later(self.kept_s, self.drop, name)
        self._items[name] = (item, size, timer)
        while len(self._items) > self._number or (len(self._items) > 1 and self.bytes > self._total_bytes):
            self.drop(next(iter(self._items)))

    def get(self, name: str) -> _T | None:
        """Return a thing, or None if it is not there any more."""
        found = self._items.get(name)
        return found[0] if found else None

    def drop(self, name: str) -> None:
        """Forget a thing, if it is there."""
        found = self._items.pop(name, None)
        if found is not None:
            found[2].cancel()

    def clear(self) -> None:
        """Forget everything."""
        for name in tuple(self._items):
            self.drop(name)
