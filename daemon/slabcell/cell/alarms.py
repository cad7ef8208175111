"""Which alarms stand?  Raised once, cleared once, with the words of the error catalogue."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import structlog

from slabcell.catalogue import Clears, Fault, entry
from slabcell.cell.events import AlarmCame, AlarmWent, Event

__all__ = ["Alarm", "Alarms"]


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm that stands, and what was said when it came."""

    fault: Fault
    detail: str


class Alarms:
    """The alarms of one cell.  ``emit`` is told when one comes and when it goes."""

    def __init__(self, emit: Callable[[Event], None]) -> None:
        self._emit = emit
        self._standing: dict[Fault, Alarm] = {}
        self.counts: Counter[Fault] = Counter()
        self._log = structlog.stdlib.get_logger("slabcell.alarm")

    @property
    def standing(self) -> tuple[Alarm, ...]:
        """The alarms that stand now, in the order in which they came."""
        return tuple(self._standing.values())

    def has(self, *faults: Fault) -> Fault | None:
        """Return the first of these that stands."""
        return next((fault for fault in faults if fault in self._standing), None)

    def come(self, fault: Fault, detail: str) -> None:
        """Raise an alarm; one that stands already is not raised again."""
        if fault in self._standing:
            return
        self._standing[fault] = Alarm(fault, detail)
        self.counts[fault] += 1
        self._log.warning("alarm came", number=int(fault), title=entry(fault).title, detail=detail)
        self._emit(AlarmCame(fault, detail))

    def cease(self, *faults: Fault) -> None:
        """Take back alarms whose cause is gone, as far as they go by themselves; others wait for a person."""
        for fault in faults:
            if fault in self._standing and entry(fault).clears is Clears.ITSELF:
                self._clear(fault)

    def acknowledge(self, fault: Fault) -> bool:
        """Clear an alarm by a person's hand; return whether it stood."""
        stood = fault in self._standing
        if stood:
            self._clear(fault)
        return stood

    def _clear(self, fault: Fault) -> None:
        del self._standing[fault]
        self._log.info("alarm went", number=int(fault), title=entry(fault).title)
        self._emit(AlarmWent(fault))
