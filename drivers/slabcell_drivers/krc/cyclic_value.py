"""What does an output show whose value follows an expression?  Held within bounds, and later than it was computed."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.values import Value

__all__ = ["CyclicOptions", "CyclicValue"]


@dataclass(frozen=True, slots=True)
class CyclicOptions:
    """DELAY (in seconds), MINIMUM and MAXIMUM of ANOUT ON."""

    delay_s: float = 0.0
    minimum: float | None = None
    maximum: float | None = None


@dataclass(slots=True)
class CyclicValue:
    """One value that is computed every tick."""

    compute: Callable[[], Value]
    clock: Clock
    options: CyclicOptions = CyclicOptions()
    _waiting: deque[tuple[float, Value]] = field(default_factory=deque[tuple[float, Value]])
    _shown: Value = None

    def now(self) -> Value:
        """Compute the value for this tick and return what is to be shown; None as long as nothing is."""
        value = self.compute()
        if isinstance(value, int | float) and not isinstance(value, bool):
            if self.options.minimum is not None:
                value = max(self.options.minimum, value)
            if self.options.maximum is not None:
                value = min(self.options.maximum, value)
        if self.options.delay_s <= 0.0:
            return value
        self._waiting.append((self.clock.now_s + self.options.delay_s, value))
        while self._waiting and self._waiting[0][0] <= self.clock.now_s + 1e-9:
            self._shown = self._waiting.popleft()[1]
        return self._shown
