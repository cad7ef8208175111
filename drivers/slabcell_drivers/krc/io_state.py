"""Which inputs, outputs, flags and timers does the controller have, and what do they hold?"""

import math
from collections.abc import Callable

from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import Value, text_of

__all__ = ["IO_COUNT", "Bits", "Flags", "InputsOutputs", "Timers"]

IO_COUNT = 8192
FLAG_COUNT = 1024
TIMER_COUNT = 64


def _index(indices: tuple[Value, ...], count: int, name: str) -> int:
    if len(indices) != 1 or type(indices[0]) is not int or not 1 <= indices[0] <= count:
        shown = ",".join(text_of(i) for i in indices)
        raise KrlError(RunMessage.INDEX, f"{name}[{shown}]: the index is not in 1 to {count}")
    return indices[0]


class Bits:
    """An array of BOOL such as $OUT; ``changed`` is called with number and value when one changes."""

    def __init__(
        self, name: str, count: int, *, writable: bool = True, changed: Callable[[int, bool], None] | None = None
    ) -> None:
        self.name = name
        self._count = count
        self._writable = writable
        self._changed = changed
        self._bits: dict[int, bool] = {}

    def __getitem__(self, number: int) -> bool:
        """Return one bit."""
        return self._bits.get(number, False)

    def put(self, number: int, value: bool) -> None:  # noqa: FBT001  # a bit is a value
        """Set one bit, from inside or outside of the program."""
        _index((number,), self._count, self.name)
        if self._bits.get(number, False) is not value:
            self._bits[number] = value
            if self._changed is not None:
                self._changed(number, value)

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return one bit to the program."""
        number = indices[0] if len(indices) == 1 else 0
        if type(number) is int and 1 <= number <= self._count:
            return self._bits.get(number, False)
        return self._bits.get(_index(indices, self._count, self.name), False)

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Set one bit from the program."""
        number = _index(indices, self._count, self.name)
        if not self._writable:
            raise KrlError(RunMessage.READ_ONLY, f"{self.name}[{number}] is write-protected")
        if type(value) is not bool:
            raise KrlError(RunMessage.ASSIGNMENT, f"{self.name}[{number}]: {text_of(value)} is no BOOL")
        self.put(number, value)

    def clear(self) -> None:
        """Reset all bits without telling anybody."""
        self._bits.clear()

    def drop(self) -> None:
        """Reset every bit that is set, as when the power goes."""
        for number in [n for n, value in self._bits.items() if value]:
            self.put(number, False)  # noqa: FBT003  # a bit is a value


class Analog:
    """$ANIN or $ANOUT: values from -1 to 1."""

    def __init__(self, name: str, *, writable: bool) -> None:
        self.name = name
        self._writable = writable
        self.values: dict[int, float] = {}

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return one value."""
        return self.values.get(_index(indices, 32, self.name), 0.0)

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Set one value.  Raises KrlError outside of -1 to 1."""
        number = _index(indices, 32, self.name)
        if not self._writable:
            raise KrlError(RunMessage.READ_ONLY, f"{self.name}[{number}] is write-protected")
        if isinstance(value, bool) or not isinstance(value, int | float) or not -1.0 <= value <= 1.0:
            raise KrlError(RunMessage.ASSIGNMENT, f"{self.name}[{number}]: {text_of(value)} is not in -1 to 1")
        self.values[number] = float(value)


class Timers:
    """$TIMER, in milliseconds: each counts up while it is not stopped."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._base_ms: dict[int, float] = {}
        self._started_s: dict[int, float] = {}

    def value_ms(self, number: int) -> int:
        """Return what a timer shows."""
        value = self._base_ms.get(number, 0.0)
        started = self._started_s.get(number)
        if started is not None:
            value += (self._clock.now_s - started) * 1000.0
        return math.floor(value + 1e-6)

    def clear(self) -> None:
        """Stop all timers at 0."""
        self._base_ms.clear()
        self._started_s.clear()

    def is_counting(self, number: int) -> bool:
        """Tell whether a timer runs."""
        return number in self._started_s

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return $TIMER[n]."""
        return self.value_ms(_index(indices, TIMER_COUNT, "$TIMER"))

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Set $TIMER[n]; a running timer goes on from there."""
        number = _index(indices, TIMER_COUNT, "$TIMER")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise KrlError(RunMessage.ASSIGNMENT, f"$TIMER[{number}]: {text_of(value)} is no INT")
        self._base_ms[number] = float(value)
        if number in self._started_s:
            self._started_s[number] = self._clock.now_s

    def stop(self, number: int, *, stopped: bool) -> None:
        """Stop a timer or let it run."""
        if stopped and number in self._started_s:
            self._base_ms[number] = float(self.value_ms(number))
            del self._started_s[number]
        elif not stopped and number not in self._started_s:
            self._started_s[number] = self._clock.now_s


class TimerStops:
    """$TIMER_STOP."""

    def __init__(self, timers: Timers) -> None:
        self._timers = timers

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Tell whether a timer is stopped."""
        return not self._timers.is_counting(_index(indices, TIMER_COUNT, "$TIMER_STOP"))

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Stop a timer, or let it run."""
        number = _index(indices, TIMER_COUNT, "$TIMER_STOP")
        if type(value) is not bool:
            raise KrlError(RunMessage.ASSIGNMENT, f"$TIMER_STOP[{number}]: {text_of(value)} is no BOOL")
        self._timers.stop(number, stopped=value)


class TimerFlags:
    """$TIMER_FLAG: TRUE while the timer is above 0."""

    def __init__(self, timers: Timers) -> None:
        self._timers = timers

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Tell whether a timer is above 0."""
        return self._timers.value_ms(_index(indices, TIMER_COUNT, "$TIMER_FLAG")) > 0

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Refuse: the flag follows the timer."""
        del indices, value
        raise KrlError(RunMessage.READ_ONLY, "$TIMER_FLAG is write-protected")


class Flags:
    """$FLAG and $CYCFLAG."""

    def __init__(self) -> None:
        self.flags = Bits("$FLAG", FLAG_COUNT)
        self.cycflags: dict[int, bool] = {}

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return $CYCFLAG[n]."""
        return self.cycflags.get(_index(indices, 256, "$CYCFLAG"), False)

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Set $CYCFLAG[n] once; the compiler makes assignments of conditions cyclic."""
        self.cycflags[_index(indices, 256, "$CYCFLAG")] = bool(value)


class InputsOutputs:
    """All of it."""

    def __init__(self, clock: Clock, output_changed: Callable[[int, bool], None]) -> None:
        self.inputs = Bits("$IN", IO_COUNT, writable=False)
        self.outputs = Bits("$OUT", IO_COUNT, changed=output_changed)
        self.analog_inputs = Analog("$ANIN", writable=False)
        self.analog_outputs = Analog("$ANOUT", writable=True)
        self.flags = Flags()
        self.timers = Timers(clock)
        self.timer_stops = TimerStops(self.timers)
        self.timer_flags = TimerFlags(self.timers)
