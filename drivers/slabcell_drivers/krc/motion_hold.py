"""Where on its path must the arm stop, and when may it go on?  STOP WHEN PATH of splines."""

import math
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["PathHold", "PathStop"]


@dataclass(frozen=True, slots=True)
class PathStop:
    """At ``at_s`` of a move the arm stops while ``holds``; ``uses_time`` tells whether mere time can end that."""

    at_s: float
    holds: Callable[[], bool]
    uses_time: bool
    where: str


class PathHold:
    """Slows the time of a move down so that it stands at its stops.  ``late`` is told when a stop comes too late."""

    def __init__(self, *, ramp_s: float, late: Callable[[str], None]) -> None:
        self._ramp_s = ramp_s
        self._late = late
        self._rate = 1.0
        self._overrun: PathStop | None = None  # the condition came too late: the arm stops behind the point
        self._approached: PathStop | None = None
        self._waiting: PathStop | None = None

    @property
    def waits(self) -> bool:
        """Tell whether the arm stands at a stop."""
        return self._waiting is not None and self._rate == 0.0

    @property
    def uses_time(self) -> bool:
        """Tell whether the stop that the arm stands at can end by mere time."""
        return self._waiting is not None and self._waiting.uses_time

    def clear(self) -> None:
        """Forget every stop."""
        self._rate, self._overrun, self._approached, self._waiting = 1.0, None, None, None

    def blocks(self, stops: list[PathStop], elapsed_s: float) -> bool:
        """Tell whether a move may not end, because it stands at a stop at its end."""
        return any(stop.at_s <= elapsed_s + 1e-6 and stop.holds() for stop in stops)

    def allowed(self, stops: list[PathStop], elapsed_s: float, seconds: float) -> float:
        """Return how much of a step the move may take; ``stops`` loses those that are passed."""
        change = seconds / self._ramp_s
        self._waiting = None
        if self._overrun is not None:
            if self._overrun.holds():
                self._rate = max(0.0, self._rate - change)
                self._waiting = self._overrun
                return seconds * self._rate
            self._overrun = None
        while stops:
            stop = stops[0]
            if not stop.holds():
                if stop.at_s > elapsed_s:
                    break
                stops.pop(0)  # passed
                continue
            left_s = max(0.0, stop.at_s - elapsed_s)
            if elapsed_s <= 0.0:  # the arm stands at the start of the move
                self._rate = 0.0
            if stop is not self._approached and self._rate**2 * self._ramp_s / 2.0 > left_s + self._rate * seconds:
                stops.pop(0)
                self._overrun = self._waiting = stop
                self._late(stop.where)
                self._rate = max(0.0, self._rate - change)
                return seconds * self._rate
            self._approached = stop
            highest = math.sqrt(2.0 * left_s / self._ramp_s)  # from here on the ramp ends at the stop
            self._rate = min(1.0, self._rate + change, highest)
            if left_s <= 1e-6:
                self._rate = 0.0
                self._waiting = stop
                return 0.0
            # the last bit of a ramp that ends in ever smaller steps is taken at once
            return min(left_s, max(seconds * self._rate, 1e-4))
        self._approached = None
        self._rate = min(1.0, self._rate + change)
        return seconds * self._rate
