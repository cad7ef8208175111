"""Which interrupts are declared, and which of them has to be served now?

An interrupt fires on the edge of its condition, while it is on, in the routine that declared it and in those that are
called from there (everywhere if it is GLOBAL).  Of several the lowest number
goes first; one that is being served gives way only to a lower number.
"""

from collections.abc import Callable

from slabcell_drivers.krc.code import Activation, Function, InterruptEntry
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import Value

__all__ = ["Interrupts"]

LAST_PRIORITY = 128


class Interrupts:
    """The interrupts of one interpreter."""

    def __init__(self, level_of: Callable[[Activation], int | None]) -> None:
        self._level_of = level_of
        self._entries: dict[int, InterruptEntry] = {}

    def __bool__(self) -> bool:
        """Tell whether any interrupt is declared."""
        return bool(self._entries)

    def clear(self) -> None:
        """Forget all interrupts."""
        self._entries.clear()

    def declare(
        self,
        number: Value,
        condition: Function,
        activation: Activation,
        label: list[int],
        *,
        is_global: bool,
        time: bool,
    ) -> None:
        """Declare an interrupt, in place of one with the same number.  Raises KrlError for a number out of range."""
        if type(number) is not int or not 1 <= number <= LAST_PRIORITY:
            raise KrlError(RunMessage.INTERRUPT, f"interrupt priority {number} is not in 1 to {LAST_PRIORITY}")
        self._entries[number] = InterruptEntry(number, condition, activation, label, is_global, time)

    def switch(self, verb: str, number: Value | None) -> None:
        """Switch one interrupt or all ON, OFF, ENABLE or DISABLE.  Raises KrlError if it is not declared."""
        if number is None:
            entries = list(self._entries.values())
        elif number in self._entries:
            entries = [self._entries[number]]
        else:
            raise KrlError(RunMessage.INTERRUPT, f"interrupt {number} is not declared")
        for entry in entries:
            if verb == "ON":
                if not entry.is_on:
                    # an edge is needed: a condition that is already true when switched on does not fire
                    entry.was_true = self._holds(entry)
                entry.is_on = True
            elif verb == "OFF":
                entry.is_on, entry.is_pending = False, False
            else:
                entry.is_enabled = verb == "ENABLE"

    def forget(self, activation: Activation) -> None:
        """Drop the interrupts that a routine declared for itself and its callees: it has ended."""
        if self._entries:
            gone = [n for n, e in self._entries.items() if e.activation is activation and not e.is_global]
            for number in gone:
                del self._entries[number]

    def waits_for_time(self) -> bool:
        """Tell whether the mere passing of time can fire an interrupt."""
        return any(e.uses_time and e.is_on for e in self._entries.values())

    def due(self, served: int) -> InterruptEntry | None:
        """Return the interrupt to serve now, None if none is due above the priority ``served`` (0: none is served)."""
        if not self._entries:
            return None
        best: InterruptEntry | None = None
        for entry in list(self._entries.values()):  # a condition may call what declares interrupts
            if not entry.is_on:
                continue
            holds = self._holds(entry)
            if holds and not entry.was_true:
                entry.is_pending = True
            entry.was_true = holds
            if (
                entry.is_pending
                and entry.is_enabled
                and (not served or entry.number < served)
                and (best is None or entry.number < best.number)
            ):
                best = entry
        if best is not None:
            best.is_pending = False
        return best

    def look_again(self, entry: InterruptEntry) -> None:
        """Note at the end of its routine that a condition holds no more: routines set timers back to fire again."""
        if self._entries.get(entry.number) is entry and entry.was_true and not self._holds(entry):
            entry.was_true = False

    def _holds(self, entry: InterruptEntry) -> bool:
        try:
            return entry.condition(entry.activation) is True
        except KrlError as error:
            if error.number == RunMessage.VALUE_INVALID:
                return False
            raise
