"""How do two programs on one machine get a serial line?  `PtyPair`: two pseudo-terminals and the wire between them.

Each end is a device file that pyserial opens like ``/dev/ttyUSB0``, but without parity, which pseudo-terminals do not
have.  Like a real line it has no flow control: what a reader leaves lying for too long is lost.
"""

import asyncio
import contextlib
import os
import tty
from collections.abc import Callable
from typing import Self

__all__ = ["PtyPair", "Wire"]

READ_BYTES = 4096

Wire = Callable[[int, bytes, Callable[[bytes], None]], None]
"""What the wire does with bytes that enter at end 0 or 1: it calls the function with what leaves at the other end."""


def _straight(_end: int, data: bytes, deliver: Callable[[bytes], None]) -> None:
    deliver(data)


class PtyPair:
    """Two device files, ``ends``, for as long as the context lasts; ``wire`` may disturb what passes."""

    def __init__(self, wire: Wire = _straight) -> None:
        self._wire = wire
        self._masters: list[int] = []
        self._slaves: list[int] = []
        self.ends: tuple[str, str] = ("", "")

    async def __aenter__(self) -> Self:
        """Make the line."""
        for _ in range(2):
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._masters.append(master)
            self._slaves.append(slave)  # held open, so that the line stays when a program closes its end
        self.ends = (os.ttyname(self._slaves[0]), os.ttyname(self._slaves[1]))
        loop = asyncio.get_running_loop()
        for end, master in enumerate(self._masters):
            loop.add_reader(master, self._pump, end)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Take the line away."""
        self.cut()

    def cut(self) -> None:
        """Take the line away: both programs find their end hung up.  May be called twice."""
        loop = asyncio.get_running_loop()
        for master in self._masters:
            loop.remove_reader(master)
            os.close(master)
        for slave in self._slaves:
            os.close(slave)
        self._masters, self._slaves = [], []

    def _pump(self, end: int) -> None:
        with contextlib.suppress(BlockingIOError):
            self._wire(end, os.read(self._masters[end], READ_BYTES), lambda data: self._deliver(1 - end, data))

    def _deliver(self, end: int, data: bytes) -> None:
        if self._masters:
            with contextlib.suppress(BlockingIOError):
                os.write(self._masters[end], data)
