"""Which alarms stand?  Logged once when one comes and once when it goes; acknowledged, shelved and counted.

An alarm that goes by itself stands as long as its cause, acknowledged or not.  One that a person has to acknowledge is
latched: it stands on when its cause is gone.  A shelved alarm still stands, and still blocks what it blocks, but it is
not shown until its time is over.  What needs no response is no alarm, but a line in the log.

Source of the words: ISA-18.2, "Management of alarm systems for the process industries".
"""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import structlog

from slabcell.catalogue import Clears, Fault, Priority, entry
from slabcell.cell.afterwards import at_once
from slabcell.cell.events import AlarmCame, AlarmChanged, AlarmWent, Event
from slabcell.errors import UsageError

__all__ = ["MAX_SHELVED_S", "Alarm", "Alarms"]

MAX_SHELVED_S = 8 * 3600.0
"""One shift: nobody may put an alarm away for good."""

TENDED_EVERY_S = 1.0

_ORDER = {Priority.HIGH: 0, Priority.MEDIUM: 1, Priority.LOW: 2}


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm that stands, and what was said when it came.

    ``came_s`` is of the monotonic clock.  ``cause_gone`` is set for a latched alarm that waits for a person only.
    ``acknowledged_by`` is who has seen an alarm that goes on as long as its cause.
    """

    fault: Fault
    detail: str
    came_s: float = 0.0
    cause_gone: bool = False
    shelved_until_s: float | None = None
    acknowledged_by: str = ""

    @property
    def priority(self) -> Priority:
        """How soon a person has to come."""
        return entry(self.fault).priority


class Alarms:
    """The alarms of one cell.  ``emit`` is told when one comes and when it goes; log lines are handed to ``later``."""

    def __init__(
        self,
        emit: Callable[[Event], None],
        *,
        later: Callable[[Callable[[], None]], None] = at_once,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._emit = emit
        self._later = later
        self._clock = clock
        self._standing: dict[Fault, Alarm] = {}
        self.counts: Counter[Fault] = Counter()
        self._log = structlog.stdlib.get_logger("slabcell.alarm")

    @property
    def standing(self) -> tuple[Alarm, ...]:
        """The alarms that stand now, in the order in which they came."""
        return tuple(self._standing.values())

    @property
    def shown(self) -> tuple[Alarm, ...]:
        """The alarms that a person shall see: the most urgent first, the newest first among equals, none shelved."""
        now_s = self._clock()
        shown = [item for item in self._standing.values() if (item.shelved_until_s or 0.0) <= now_s]
        return tuple(sorted(shown, key=lambda item: (_ORDER[item.priority], -item.came_s)))

    def has(self, *faults: Fault) -> Fault | None:
        """Return the first of these that stands."""
        return next((fault for fault in faults if fault in self._standing), None)

    def come(self, fault: Fault, detail: str) -> None:
        """Raise an alarm; one that stands already is not raised again, but its cause is back."""
        standing = self._standing.get(fault)
        if standing is not None:
            self._standing[fault] = replace(standing, cause_gone=False)
            return
        self._standing[fault] = Alarm(fault, detail, self._clock())
        self.counts[fault] += 1
        words = entry(fault)
        about = {"title": words.title, "detail": detail, "priority": words.priority.value}
        self._later(lambda: self._log.warning("alarm came", number=int(fault), **about))
        self._emit(AlarmCame(fault, detail))

    def cease(self, *faults: Fault) -> None:
        """Take back alarms whose cause is gone, as far as they go by themselves; others wait for a person."""
        for fault in faults:
            standing = self._standing.get(fault)
            if standing is None:
                continue
            if entry(fault).clears is Clears.ITSELF:
                self._clear(fault, "its cause is gone")
            else:
                self._standing[fault] = replace(standing, cause_gone=True)

    def acknowledge(self, fault: Fault, by: str = "a person") -> bool:
        """Note that a person has seen an alarm; return whether it stood.

        A latched one goes.  Any other stands on until its cause is gone, or until a restart.
        """
        standing = self._standing.get(fault)
        if standing is None:
            return False
        if entry(fault).clears is Clears.ACKNOWLEDGE:
            self._clear(fault, f"acknowledged by {by}")
        elif not standing.acknowledged_by:
            self._standing[fault] = replace(standing, acknowledged_by=by)
            self._later(lambda: self._log.info("alarm acknowledged", number=int(fault), by=by))
            self._emit(AlarmChanged(fault))
        return True

    def settle(self, fault: Fault, why: str) -> None:
        """Take an alarm back whatever it needs, because the cell itself has seen to its cause."""
        if fault in self._standing:
            self._clear(fault, why)

    def shelve(self, fault: Fault, duration_s: float) -> None:
        """Do not show an alarm that stands for a while.  Raises UsageError for a time that is too long."""
        if not 0.0 < duration_s <= MAX_SHELVED_S:
            limit = f"more than 0 and at most {MAX_SHELVED_S:g} s"
            msg = f"alarm {int(fault)} cannot be shelved for {duration_s:g} s; {limit} are possible"
            raise UsageError(msg)
        standing = self._find(fault)
        self._standing[fault] = replace(standing, shelved_until_s=self._clock() + duration_s)
        self._later(lambda: self._log.info("alarm shelved", number=int(fault), duration_s=duration_s))
        self._emit(AlarmChanged(fault))

    def unshelve(self, fault: Fault) -> None:
        """Show a shelved alarm again.  Raises UsageError if it does not stand."""
        self._standing[fault] = replace(self._find(fault), shelved_until_s=None)
        self._later(lambda: self._log.info("alarm unshelved", number=int(fault)))
        self._emit(AlarmChanged(fault))

    async def tend(self) -> None:
        """Show what was shelved again as its time is over; runs until it is cancelled."""
        while True:
            self.show_due()
            await asyncio.sleep(TENDED_EVERY_S)

    def show_due(self) -> None:
        """Show again, and tell of, what was shelved for a time that is over."""
        now_s = self._clock()
        for alarm in self.standing:
            if alarm.shelved_until_s is not None and alarm.shelved_until_s <= now_s:
                self.unshelve(alarm.fault)

    def _find(self, fault: Fault) -> Alarm:
        if fault not in self._standing:
            msg = f"alarm {int(fault)} does not stand"
            raise UsageError(msg)
        return self._standing[fault]

    def _clear(self, fault: Fault, why: str) -> None:
        del self._standing[fault]
        self._later(lambda: self._log.info("alarm went", number=int(fault), title=entry(fault).title, why=why))
        self._emit(AlarmWent(fault, why))
