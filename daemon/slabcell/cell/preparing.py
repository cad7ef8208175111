"""May the cell become ready?  Only with a calibration; until there is one it waits, and says what for.

A new cell has no calibration, and needs its camera for the first one: it starts all the same, stays `initialized`, and
every trigger is refused by number.
"""

from __future__ import annotations

from slabcell.calibration.model import Calibration
from slabcell.catalogue import Fault
from slabcell.cell.alarms import Alarms
from slabcell.cell.states import CellEvent, Conditions, HeldCause, StateMachine
from slabcell.errors import CalibrationError

__all__ = ["NO_CALIBRATION", "Preparation", "require_calibration"]

NO_CALIBRATION = "no calibration is in use: make one and activate it (page Calibrate, or `slabcell calibration`)"


def require_calibration(calibration: Calibration | None) -> Calibration:
    """Return the calibration.  Raises CalibrationError with its number where there is none."""
    if calibration is None:
        raise CalibrationError(NO_CALIBRATION, number=Fault.CALIBRATION_MISSING)
    return calibration


class Preparation:
    """Takes the last step to `ready`."""

    def __init__(self, machine: StateMachine, alarms: Alarms, conditions: Conditions) -> None:
        self._machine = machine
        self._alarms = alarms
        self._conditions = conditions

    def look(self, calibration: Calibration | None) -> bool:
        """Return whether there is a calibration; alarm and cause of holding say so, or go."""
        if calibration is None:
            self._conditions.held = HeldCause.CALIBRATION
            self._alarms.come(Fault.CALIBRATION_MISSING, NO_CALIBRATION)
            return False
        if self._conditions.held is HeldCause.CALIBRATION:
            self._conditions.held = None
        self._alarms.settle(Fault.CALIBRATION_MISSING, "a calibration is in use")
        return True

    async def finish(self, calibration: Calibration | None, recipe: str) -> None:
        """Become ready if there is a calibration; without one the state stays `initialized`."""
        if self.look(calibration):
            await self._machine.fire(CellEvent.PREPARE, f"recipe {recipe}")
