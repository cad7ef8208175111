"""Which system variables are there, what do they say, and which of them stop the advance run?

Assigned variables are plain cells; what the controller itself knows (positions, time, I/O) is computed on reading.
A name not listed here becomes a variable of any type when it is first used: there are thousands.
"""

import datetime
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from slabcell_drivers.krc.cells import Cell, ComputedCell, Place, Trait
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.io_state import IO_COUNT, InputsOutputs
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion_planner import AXIS_FIELDS
from slabcell_drivers.krc.operators import set_frame
from slabcell_drivers.krc.values import (
    BOOL,
    CHAR,
    INT,
    REAL,
    ArrayType,
    ArrayValue,
    CharArray,
    EnumConstant,
    KrlType,
    StructType,
    StructValue,
    Value,
)
from slabcell_drivers.robot.arm import ArmModel, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["ArmState", "SystemVariables"]

_STOP = frozenset({Trait.STOPS_ADVANCE})
_TIME = frozenset({Trait.TIME})
_STOP_AND_TIME = _STOP | _TIME

_NO_STOP: frozenset[Trait] = frozenset()
HOME_TOLERANCE_DEG = 1.0
POSITION_TRAITS = _NO_STOP
"""Reading $POS_ACT or $AXIS_ACT does not stop the advance run here, so that a missing WAIT SEC 0 shows; on a controller
it may (the public sources contradict each other)."""


class ArmState:
    """What the system variables ask of the arm: axes, tool centre point and velocities, now."""

    def __init__(
        self,
        arm: ArmModel,
        axes: Callable[[], Axes],
        tool: Callable[[], Frame],
        base: Callable[[], Frame],
        is_moving: Callable[[], bool],
        axis_rates_deg_s: Callable[[], Axes],
        tcp_speed_m_s: Callable[[], float],
    ) -> None:
        self.arm = arm
        self.axes = axes
        self.tool = tool
        self.base = base
        self.is_moving = is_moving
        self.axis_rates_deg_s = axis_rates_deg_s
        self.tcp_speed_m_s = tcp_speed_m_s

    def tcp_in_base(self) -> Frame:
        """Return the tool centre point in the base of the main run."""
        return self.base().inverse() @ self.arm.forward(self.axes()) @ self.tool()


class _ComputedArray:
    """An array of the system that is computed on reading."""

    def __init__(self, name: str, read: Callable[[], Sequence[float]]) -> None:
        self._name = name
        self._read = read

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return an element.  Raises KrlError beyond its size."""
        values = self._read()
        if len(indices) != 1 or type(indices[0]) is not int or not 1 <= indices[0] <= len(values):
            raise KrlError(RunMessage.INDEX, f"{self._name}: the index is not in 1 to {len(values)}")
        return float(values[indices[0] - 1])

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Refuse."""
        del indices, value
        raise KrlError(RunMessage.READ_ONLY, f"{self._name} is write-protected")


class SystemVariables:
    """The system variables of one controller."""

    def __init__(self, io: InputsOutputs, clock: Clock, state: ArmState, find_type: Callable[[str], KrlType]) -> None:
        self._cells: dict[str, Place] = {}
        self._find_type = find_type
        self._clock = clock
        self._state = state
        self._io = io

    def populate(self) -> None:
        """Make the variables: the predefined types have to be known."""
        self._add_io()
        self._add_positions()
        self._add_settings()
        self._add_status()

    def find(self, name: str) -> Place:
        """Return a system variable; one unknown to this software is made."""
        cell = self._cells.get(name)
        if cell is None:
            cell = self._cells[name] = Cell(name, None)
        return cell

    def read(self, name: str) -> Value:
        """Return the value of a system variable, None if it was never set."""
        return self.find(name).value

    def write(self, name: str, value: Value) -> None:
        """Set a variable from the controller's side."""
        cell = self.find(name)
        if isinstance(cell, Cell):
            cell.value = cell.coerce(value)
        else:
            cell.set(value)

    # --- making them --------------------------------------------------------------------------------------------

    def _struct(self, name: str) -> StructType:
        type_ = self._find_type(name)
        assert isinstance(type_, StructType)  # noqa: S101  # predefined.dat declares it
        return type_

    def _variable(
        self, name: str, type_: KrlType | None, value: Value = None, *, traits: frozenset[Trait] = _NO_STOP
    ) -> None:
        cell = Cell(name, type_, traits=traits)
        if value is not None:
            cell.set(value)
        self._cells[name] = cell

    def _holding(self, name: str, container: object, *, traits: frozenset[Trait] = _NO_STOP) -> None:
        cell = Cell(name, None, traits=traits)
        cell.value = container
        self._cells[name] = cell

    def _computed(
        self, name: str, type_: KrlType | None, read: Callable[[], Value], *, traits: frozenset[Trait] = _NO_STOP
    ) -> None:
        self._cells[name] = ComputedCell(name, type_, read, traits=traits)

    def _add_io(self) -> None:
        io = self._io
        self._holding("$IN", io.inputs, traits=_STOP)
        self._holding("$OUT", io.outputs, traits=_STOP)
        self._holding("$OUT_C", io.outputs)
        self._holding("$IN_C", io.inputs)
        self._holding("$ANIN", io.analog_inputs, traits=_STOP)
        self._holding("$ANOUT", io.analog_outputs, traits=_STOP)
        self._holding("$FLAG", io.flags.flags)
        self._holding("$CYCFLAG", io.flags, traits=_TIME)
        self._holding("$TIMER", io.timers, traits=_STOP_AND_TIME)
        self._holding("$TIMER_STOP", io.timer_stops)
        self._holding("$TIMER_FLAG", io.timer_flags, traits=_STOP_AND_TIME)

    def _add_positions(self) -> None:
        state = self._state
        axis_type, pos_type = self._struct("E6AXIS"), self._struct("E6POS")

        def axes() -> StructValue:
            fields: dict[str, Value] = dict(zip(AXIS_FIELDS, state.axes(), strict=True))
            fields |= dict.fromkeys(("E1", "E2", "E3", "E4", "E5", "E6"), 0.0)
            return StructValue(axis_type, fields)

        def position() -> StructValue:
            tool = self._cells["$TOOL"].value
            if not isinstance(tool, StructValue) or not tool.fields:
                raise KrlError(RunMessage.TOOL_MISSING, "TOOL not programmed: $TOOL was never set")
            value = set_frame(StructValue(pos_type, {}), state.tcp_in_base())
            status, turn = state.arm.status_turn(state.axes())
            value.fields |= {"S": status, "T": turn}
            value.fields |= dict.fromkeys(("E1", "E2", "E3", "E4", "E5", "E6"), 0.0)
            return value

        for name in ("$AXIS_ACT", "$AXIS_ACT_MEAS", "$AXIS_INT", "$AXIS_RET", "$AXIS_FOR", "$AXIS_BACK"):
            self._computed(name, axis_type, axes, traits=POSITION_TRAITS)
        for name in ("$POS_ACT", "$POS_ACT_MES", "$POS_INT", "$POS_RET", "$POS_FOR", "$POS_BACK"):
            self._computed(name, pos_type, position, traits=POSITION_TRAITS)

        def frame(source: Callable[[], Frame]) -> Callable[[], Value]:
            return lambda: set_frame(StructValue(self._struct("FRAME"), {}), source())

        self._computed("$TOOL_C", self._struct("FRAME"), frame(state.tool))
        self._computed("$BASE_C", self._struct("FRAME"), frame(state.base))
        self._add_speeds()

    def _add_speeds(self) -> None:
        state = self._state
        no_external = (0.0,) * 6

        def rates_percent() -> Sequence[float]:
            rates, full = state.axis_rates_deg_s(), state.arm.axis_speed_deg_s
            return (*(100.0 * rate / limit for rate, limit in zip(rates, full, strict=True)), *no_external)

        self._computed("$VEL_ACT", REAL, state.tcp_speed_m_s)
        self._holding("$VEL_AXIS_ACT", _ComputedArray("$VEL_AXIS_ACT", rates_percent))
        self._computed("$IN_HOME", BOOL, self._is_home, traits=_STOP)

    def _is_home(self) -> bool:
        """Tell whether every axis is within 1 degree of $H_POS: on a controller $H_POS_TOL says how near is near."""
        home = self.read("$H_POS")
        if not isinstance(home, StructValue):
            return False
        pairs = [(home.fields.get(name), now) for name, now in zip(AXIS_FIELDS, self._state.axes(), strict=True)]
        return all(wanted is not None and abs(float(wanted) - now) <= HOME_TOLERANCE_DEG for wanted, now in pairs)

    def _is(self, name: str, constant: str) -> bool:
        value = self.read(name)
        return isinstance(value, EnumConstant) and value.name == constant

    def _add_settings(self) -> None:
        frame = self._struct("FRAME")
        zero = set_frame(StructValue(frame, {}), Frame())
        self._variable("$NULLFRAME", frame, zero)
        self._variable("$WORLD", frame, zero)
        self._variable("$ROBROOT", frame, zero)
        self._variable("$TOOL", frame)
        self._variable("$BASE", frame)
        self._variable("$LOAD", self._struct("LOAD"))
        self._variable("$LOAD_A3", self._struct("LOAD"))
        self._variable("$VEL", self._struct("CP"))
        self._variable("$ACC", self._struct("CP"))
        self._variable("$APO", self._struct("APO"))
        for name in ("$VEL_AXIS", "$ACC_AXIS", "$VEL_EXTAX", "$ACC_EXTAX", "$GEAR_JERK"):
            self._variable(name, ArrayType(REAL, (12,)))
        self._variable("$ADVANCE", INT, 3)
        self._variable("$OV_PRO", INT, 100)
        self._variable("$OV_JOG", INT, 10)
        self._variable("$OV_APPL", INT, 100)
        self._variable("$RED_VEL", REAL, 100.0)
        self._variable("$IPO_MODE", None, EnumConstant("BASE"))
        self._variable("$ORI_TYPE", None, EnumConstant("VAR"))
        self._variable("$CIRC_TYPE", None, EnumConstant("BASE"))
        self._variable("$ACT_TOOL", INT, 0)
        self._variable("$ACT_BASE", INT, 0)
        self._variable("$ACT_TOOL_C", INT, 0)
        self._variable("$ACT_BASE_C", INT, 0)
        self._variable("$ACT_EX_AX", INT, 0)
        self._variable("$NUM_AX", INT, 6)
        self._variable("$NUM_IN", INT, IO_COUNT)
        self._variable("$NUM_OUT", INT, IO_COUNT)
        self._variable("$FILTER", INT, 0)
        self._variable("$EX_AX_NUM", INT, 0)
        self._variable("$KINCLASS", None, EnumConstant("STANDARD"))
        self._variable("$ADAP_ACC", None, EnumConstant("NONE"))
        self._variable("$TCP_IPO", BOOL, value=False)
        self._variable("$PAL_MODE", BOOL, value=False)
        self._variable("$H_POS", self._struct("E6AXIS"))

    def _add_status(self) -> None:
        clock, state = self._clock, self._state
        self._variable("$MODE_OP", None, EnumConstant("AUT"), traits=_STOP)
        for name in ("$PERI_RDY", "$DRIVES_ON", "$USER_SAF", "$ALARM_STOP", "$MOVE_ENABLE", "$I_O_ACT", "$ON_PATH"):
            self._variable(name, BOOL, value=True, traits=_STOP)
        self._variable("$NEAR_POSRET", BOOL, value=True)
        for name, mode in (("$T1", "T1"), ("$T2", "T2"), ("$AUT", "AUT"), ("$EXT", "EX")):
            self._computed(name, BOOL, partial(self._is, "$MODE_OP", mode), traits=_STOP)
        for name in ("$STOPMESS", "$AUX_POWER", "$POWER_FAIL", "$MOVE_BCO"):
            self._variable(name, BOOL, value=False)
        for name in ("$DRIVES_ENABLE", "$ALARM_STOP_INTERN", "$COULD_START_MOTION", "$I_O_ACTCONF"):
            self._variable(name, BOOL, value=True)
        self._variable("$PRO_STATE0", None, EnumConstant("P_ACTIVE"))
        self._variable("$PRO_STATE1", None, EnumConstant("P_FREE"))
        self._variable("$PRO_STATE", None, EnumConstant("P_FREE"))
        self._variable("$PRO_MODE", None, EnumConstant("GO"))
        self._computed("$PRO_MOVE", BOOL, state.is_moving, traits=_STOP)
        self._computed("$PRO_ACT", BOOL, lambda: self._is("$PRO_STATE1", "P_ACTIVE"), traits=_STOP)
        self._variable("$PRO_NAME", ArrayType(CHAR, (24,)))
        self._variable("$PRO_NAME1", ArrayType(CHAR, (24,)))
        self._variable("$ROBNAME", ArrayType(CHAR, (24,)), state.arm.name[:24])
        self._variable("$ROBTRAFO", ArrayType(CHAR, (32,)), f"#{state.arm.name.upper()}"[:32])
        self._variable("$ERR", self._struct("ERROR_T"))
        self.clear_error()
        self._variable("$KR_SERIALNO", INT, 0)
        self._variable("$TRAFONAME", ArrayType(CHAR, (32,)), f"#{state.arm.name.upper()}"[:32])
        self._variable("$INTERPRETER", INT, 1)
        self._variable("$CMD", INT, 1)
        self._variable("$MSG_PRESENT", BOOL, value=False)
        self._variable("$LOOP_MSG", ArrayType(CHAR, (128,)))
        self._computed("$ROBRUNTIME", INT, lambda: int(clock.now_s / 60.0), traits=_TIME)
        self._computed("$ROB_TIMER", INT, lambda: math.floor(clock.now_s * 1000.0), traits=_TIME)
        self._computed("$ROB_STOPPED", BOOL, lambda: not state.is_moving(), traits=_STOP)
        date = self._struct("DATE")

        def now() -> StructValue:
            moment = datetime.datetime.fromtimestamp(clock.now_s, tz=datetime.UTC)
            return StructValue(
                date,
                {
                    "CSEC": moment.microsecond // 10000,
                    "SEC": moment.second,
                    "MIN": moment.minute,
                    "HOUR": moment.hour,
                    "DAY": moment.day,
                    "MONTH": moment.month,
                    "YEAR": moment.year,
                },
            )

        self._computed("$DATE", date, now, traits=_TIME)

    # --- what the kernel sets -----------------------------------------------------------------------------------

    def clear_error(self) -> None:
        """Reset $ERR."""
        self.set_error(0, "", 0, "")

    def set_error(self, number: int, module: str, line: int, routine: str) -> None:
        """Set $ERR."""
        value = StructValue(
            self._struct("ERROR_T"),
            {
                "NUMBER": number,
                "MODULE": CharArray(24, module[:24]),
                "LINE_NR": line,
                "UP_NAME": CharArray(24, routine[:24]),
                "INTERPRETER": EnumConstant("R_INT"),
                "INT_TYPE": EnumConstant("I_NORMAL"),
                "INT_PRIO": 0,
                "TRIGGER_TYPE": EnumConstant("TRG_NONE"),
            },
        )
        self.write("$ERR", value)

    def reset_motion_settings(self) -> None:
        """Forget speeds, tool and base: selecting a program does, so that each has to set its own."""
        for name, type_name in (("$TOOL", "FRAME"), ("$BASE", "FRAME"), ("$VEL", "CP"), ("$ACC", "CP")):
            self.write(name, StructValue(self._struct(type_name), {}))
        for name in ("$VEL_AXIS", "$ACC_AXIS"):
            self.write(name, ArrayValue(ArrayType(REAL, (12,))))

    def names(self) -> Mapping[str, Place]:
        """Return all variables made so far."""
        return self._cells
