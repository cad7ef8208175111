"""What can go wrong on the cable between controller and cell?  Faults at a chosen telegram, in either direction.

A `LinkFaults` stands for one cable.  It wraps every connection that an `EthernetKrl` makes; without a fault it changes
nothing.  A unit here is what one send or one receive moves: in lock-step that is one telegram.
"""

import random
import time
from collections import deque
from collections.abc import Callable
from enum import StrEnum

from slabcell_drivers.krc.eki_transport import LinkClosedError, Transport

__all__ = ["Fault", "FaultyTransport", "LinkFaults", "Way"]


class Way(StrEnum):
    """Which way a unit of bytes goes, seen from the controller."""

    SENT = "sent"
    RECEIVED = "received"


class Fault(StrEnum):
    """What happens to one unit of bytes."""

    NONE = "none"
    DELAY = "delay"  # it, and all behind it, comes late
    DUPLICATE = "duplicate"  # it comes twice
    GARBLE = "garble"  # some bytes are others
    DROP = "drop"  # it never comes (a peer that lost it; TCP itself would repeat)
    SPLIT = "split"  # it comes in two parts, the second at the next poll
    BREAK_BEFORE = "break_before"  # the connection ends instead
    BREAK_INSIDE = "break_inside"  # half of it comes, then the connection ends
    BREAK_AFTER = "break_after"  # it comes, then the connection ends


class LinkFaults:
    """One cable and what is planned to happen on it."""

    def __init__(self, rng: random.Random, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.is_cut = False
        self.delay_s = 0.5
        """How late a delayed unit is."""
        self.rng = rng
        self.clock = clock
        self._planned: dict[Way, dict[int, Fault]] = {way: {} for way in Way}
        self._passed = dict.fromkeys(Way, 0)
        self._transports: list[FaultyTransport] = []
        self._abandoned: list[Transport] = []

    @property
    def reachable(self) -> bool:
        """Whether a new connection can be made."""
        return not self.is_cut

    def passed(self, way: Way) -> int:
        """Return how many units went this way so far."""
        return self._passed[way]

    def plan(self, way: Way, fault: Fault, *, after: int = 0) -> None:
        """Let a fault befall the unit that follows ``after`` more units on this way."""
        self._planned[way][self._passed[way] + after] = fault

    def cut(self) -> None:
        """Cut the cable: nothing passes, nobody is told, the host answers no ping; new connections fail."""
        self.is_cut = True

    def forget(self) -> None:
        """Let the connections that exist now be forgotten on the way: half-open for both ends.  New ones work."""
        for transport in self._transports:
            transport.forgotten = True

    def repair(self) -> None:
        """Mend the cable: what was held passes, and ends that gave up meanwhile are told to the peer."""
        self.is_cut = False
        self._close_abandoned()

    def wrap(self, transport: Transport) -> Transport:
        """Return the connection as it runs over this cable."""
        self._transports = [t for t in self._transports if not t.closed]
        wrapped = FaultyTransport(transport, self)
        self._transports.append(wrapped)
        return wrapped

    def take(self, way: Way) -> Fault:
        """Return what shall befall the next unit, and count it."""
        fault = self._planned[way].pop(self._passed[way], Fault.NONE)
        self._passed[way] += 1
        return fault

    def abandon(self, transport: Transport) -> None:
        """Keep a connection whose end cannot be told to the peer."""
        self._abandoned.append(transport)

    def close(self) -> None:
        """Close what was kept; no socket is left open."""
        self._close_abandoned()

    def _close_abandoned(self) -> None:
        for transport in self._abandoned:
            transport.close()
        self._abandoned.clear()


class FaultyTransport:
    """A connection over a faulty cable."""

    def __init__(self, inner: Transport, link: LinkFaults) -> None:
        self.forgotten = False
        self.closed = False
        self._inner = inner
        self._link = link
        # bytes on their way with the time when they arrive; None is the end of the connection
        self._outgoing: deque[tuple[float, bytes | None]] = deque()
        self._incoming: deque[tuple[float, bytes | None]] = deque()
        self._peer_closed = False

    def readable_fd(self) -> int | None:
        """Return the descriptor to wait on; None once the peer's end of the connection has arrived here."""
        return None if self._peer_closed else self._inner.readable_fd()

    def send(self, data: bytes) -> None:
        """Put bytes on the way."""
        self._put(self._outgoing, Way.SENT, data)
        self.pump()

    def receive(self) -> bytes:
        """Return the next unit that has come through."""
        self._take_in()
        if self._held:
            return b""
        if not self._incoming or self._incoming[0][0] > self._link.clock():
            return b""
        _, data = self._incoming.popleft()
        if data is None:
            self._peer_closed = True
            self._inner.close()
            msg = "the connection broke"
            raise LinkClosedError(msg)
        return data

    def pump(self) -> bool:
        """Send what is due."""
        moved = False
        while not self._held and self._outgoing and self._outgoing[0][0] <= self._link.clock():
            _, data = self._outgoing.popleft()
            if data is None:
                self._inner.close()
                msg = "the connection broke"
                raise LinkClosedError(msg)
            self._inner.send(data)
            moved = True
        if not self._held and not self._peer_closed:
            moved |= self._inner.pump()
        return moved

    @property
    def peer_answers_ping(self) -> bool:
        """Not while the cable is cut."""
        return not self._link.is_cut and self._inner.peer_answers_ping

    def close(self) -> None:
        """Close the connection; the peer learns of it only over a sound cable."""
        if self.closed:
            return
        self.closed = True
        if self._held:
            self._link.abandon(self._inner)
        else:
            self._inner.close()

    @property
    def _held(self) -> bool:
        return self.forgotten or self._link.is_cut

    def _take_in(self) -> None:
        """Read the socket even while nothing passes, so that waiting on it does not spin."""
        if self._peer_closed:
            return
        try:
            data = self._inner.receive()
        except LinkClosedError:
            self._peer_closed = True
            self._incoming.append((0.0, None))
            return
        if data:
            self._put(self._incoming, Way.RECEIVED, data)

    def _put(self, queue: deque[tuple[float, bytes | None]], way: Way, data: bytes) -> None:
        now = self._link.clock()
        match self._link.take(way):
            case Fault.NONE:
                queue.append((now, data))
            case Fault.DELAY:
                queue.append((now + self._link.delay_s, data))
            case Fault.DUPLICATE:
                queue.extend([(now, data), (now, data)])
            case Fault.GARBLE:
                queue.append((now, self._garbled(data)))
            case Fault.DROP:
                pass
            case Fault.SPLIT:
                cut = self._link.rng.randrange(len(data) + 1)
                queue.extend([(now, data[:cut]), (now, data[cut:])])
            case Fault.BREAK_BEFORE:
                queue.append((now, None))
            case Fault.BREAK_INSIDE:
                queue.extend([(now, data[: len(data) // 2]), (now, None)])
            case Fault.BREAK_AFTER:
                queue.extend([(now, data), (now, None)])

    def _garbled(self, data: bytes) -> bytes:
        changed = bytearray(data)
        for _ in range(self._link.rng.randint(1, 3)):
            changed[self._link.rng.randrange(len(changed))] ^= 1 << self._link.rng.randrange(8)
        return bytes(changed)
