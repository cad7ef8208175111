"""Which system variables exist, for a check that runs nothing?  The known ones with their types; others are taken."""

from slabcell_drivers.krc.cells import Cell, Place
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.io_state import InputsOutputs
from slabcell_drivers.krc.values import BOOL, INT, REAL, ArrayType, KrlType

__all__ = ["SystemNames"]

_ARRAYS: dict[str, KrlType] = {
    "$IN": BOOL,
    "$OUT": BOOL,
    "$FLAG": BOOL,
    "$CYCFLAG": BOOL,
    "$TIMER": INT,
    "$TIMER_STOP": BOOL,
    "$TIMER_FLAG": BOOL,
    "$ANIN": REAL,
    "$ANOUT": REAL,
}
_SCALARS: dict[str, KrlType] = {
    "$ADVANCE": INT,
    "$OV_PRO": INT,
    "$STOPMESS": BOOL,
    "$PERI_RDY": BOOL,
    "$ALARM_STOP": BOOL,
    "$USER_SAF": BOOL,
    "$ACT_TOOL": INT,
    "$ACT_BASE": INT,
}


class SystemNames:
    """System variables without a controller behind them."""

    def __init__(self, clock: Clock) -> None:
        io = InputsOutputs(clock, lambda _number, _value: None)
        self._cells: dict[str, Place] = {name: Cell(name, type_) for name, type_ in _SCALARS.items()}
        containers = {
            "$IN": io.inputs,
            "$OUT": io.outputs,
            "$ANIN": io.analog_inputs,
            "$ANOUT": io.analog_outputs,
            "$FLAG": io.flags.flags,
        }
        for name, type_ in _ARRAYS.items():
            cell = Cell(name, None)
            cell.value = containers.get(name)
            cell.type = ArrayType(type_, (1,))
            self._cells[name] = cell

    def find(self, name: str) -> Place:
        """Return a system variable; one unknown to this software is made."""
        cell = self._cells.get(name)
        if cell is None:
            cell = self._cells[name] = Cell(name, None)
        return cell
