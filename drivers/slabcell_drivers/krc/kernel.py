"""What happens in one tick of the controller?  Time, network, motion, interrupts and a slice of the program.

Time is virtual: a tick of 12 ms takes as long as its work.  Three things tie it to the clock on the wall: a speed that
was asked for; an answer from the network that is outstanding; and a wait for something that only another thread or the
network can bring.
"""

import heapq
import itertools
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from slabcell_drivers.krc.builtin_table import Builtin
from slabcell_drivers.krc.builtins_basic import BASIC_BUILTINS
from slabcell_drivers.krc.builtins_buffers import BUFFER_BUILTINS
from slabcell_drivers.krc.builtins_eki import EKI_BUILTINS
from slabcell_drivers.krc.builtins_messages import MESSAGE_BUILTINS
from slabcell_drivers.krc.builtins_motion import MOTION_BUILTINS
from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.code import Activation, Code, Pause
from slabcell_drivers.krc.compile_expressions import ExpressionCompiler
from slabcell_drivers.krc.eki import EkiStatus, EthernetKrl
from slabcell_drivers.krc.interpreter import Interpreter
from slabcell_drivers.krc.io_state import InputsOutputs
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion import INTERPOLATION_TICK_S
from slabcell_drivers.krc.motion_move import Move
from slabcell_drivers.krc.motion_orders import TriggerOrder
from slabcell_drivers.krc.motion_planner import MotionPlanner
from slabcell_drivers.krc.motion_runner import MotionRunner
from slabcell_drivers.krc.parser import parse
from slabcell_drivers.krc.scope import Project
from slabcell_drivers.krc.smartpad import MessageWindow, ShownMessage
from slabcell_drivers.krc.syntax import Assign, Expr
from slabcell_drivers.krc.system import ArmState, SystemVariables
from slabcell_drivers.krc.values import CharArray, KrlType, StructValue, Value
from slabcell_drivers.robot.arm import ArmModel, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["BUILTINS", "Hooks", "Kernel"]

STATEMENT_S = 50e-6
"""Time that one operation takes: 240 of them in a tick.  Not published; loops that wait without WAIT need some."""

_COMMANDS = {"CANCEL": "cancelled", "RESET": "reset", "STOP": "stopped"}
"""What CWRITE can order, and how the program ends then."""

BUILTINS: Mapping[str, Builtin] = {
    **BASIC_BUILTINS,
    **MOTION_BUILTINS,
    **MESSAGE_BUILTINS,
    **BUFFER_BUILTINS,
    **EKI_BUILTINS,
}


@dataclass(frozen=True, slots=True)
class Ending:
    """Why a program stops: the status of its result, number and text of the message."""

    status: str
    number: int
    text: str


@dataclass(frozen=True, slots=True)
class Hooks:
    """Where the kernel says what happens."""

    output_changed: Callable[[int, bool], None]
    moved: Callable[[Frame], None]
    move_started: Callable[[Move], None]
    message_shown: Callable[[ShownMessage], None]
    dialog: Callable[[ShownMessage], int]


class Kernel:
    """All parts of the controller, and the tick that moves them on."""

    def __init__(
        self,
        *,
        arm: ArmModel,
        home: Axes,
        hooks: Hooks,
        make_eki: Callable[[InputsOutputs, Clock, random.Random], EthernetKrl],
        seed: int,
        speed: float | None,
    ) -> None:
        self.clock = Clock()
        self.rng = random.Random(seed)  # noqa: S311  # for repeatable runs, not for secrets
        self.speed = speed
        self.statement_s = STATEMENT_S
        self.io = InputsOutputs(self.clock, hooks.output_changed)
        self.messages = MessageWindow(self.clock, shown=hooks.message_shown, answer=hooks.dialog)
        state = ArmState(
            arm,
            lambda: self.motion.axes,
            lambda: self.motion.tool,
            lambda: self.motion.base,
            lambda: self.motion.is_moving,
            lambda: self.motion.axis_rates_deg_s,
            lambda: self.motion.tcp_speed_m_s,
        )
        self.system = SystemVariables(self.io, self.clock, state, self._predefined_type)
        self.project = Project(self.system, BUILTINS)
        self.motion = MotionRunner(
            MotionPlanner(arm, self.system, home),
            self.clock,
            moved=hooks.moved,
            notify=self._notify,
            started=hooks.move_started,
            fire=self._fire,
        )
        self.interpreter = Interpreter(self, self.project, self.motion, self.clock)
        self.submit = Interpreter(self, self.project, self.motion, self.clock, may_move=False)
        self._running = self.interpreter
        self.eki = make_eki(self.io, self.clock, self.rng)
        self.error_text = ""
        self.ending: Ending | None = None
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._event_numbers = itertools.count()
        self._network_is_due = False
        self._operator_is_due = False
        self.open_dialog: tuple[int, Place] | None = None
        self._wall_s = time.monotonic()

    def _predefined_type(self, name: str) -> KrlType:
        type_ = self.project.find_type(name, None)
        if type_ is None:
            message = f"predefined.dat does not declare {name}"
            raise LookupError(message)
        return type_

    def _fire(self, trigger: TriggerOrder) -> None:
        self.interpreter.fire(trigger)

    def _notify(self, number: int, content: str) -> None:
        self.messages.show("NOTIFY", "KRC", int(number), content)

    # --- time ---------------------------------------------------------------------------------------------------

    def tick(self, pause: Pause | None) -> None:
        """Let one tick of the interpolation pass."""
        step_s = INTERPOLATION_TICK_S
        if self.speed is not None:
            self._wait_for_wall(step_s / self.speed)
        elif self._is_tied_to_wall(pause):
            began = time.monotonic()
            self.eki.poll(step_s)
            step_s = min(step_s, max(1e-4, time.monotonic() - began))
        else:
            self.eki.poll()
        self.clock.now_s += step_s
        while self._events and self._events[0][0] <= self.clock.now_s:
            heapq.heappop(self._events)[2]()
        self.motion.step(step_s)
        self.interpreter.check_interrupts()
        self._run_submit()

    def _run_submit(self) -> None:
        if self.submit.is_done:
            return
        self._running = self.submit
        try:
            self.submit.run_slice(self.quota)
        except KrlError as error:
            file, line = self.submit.place
            self.messages.show("QUIT", "SUBMIT", error.number, f"{error.text} ({file} {line})")
            self.submit.deselect()
        finally:
            self._running = self.interpreter

    def telegram_came(self) -> None:
        """Note that what the program waited for may have come."""
        self._network_is_due = False

    def _is_tied_to_wall(self, pause: Pause | None) -> bool:
        if self.motion.is_moving:
            return False
        if self._network_is_due and self.eki.is_open:
            return True
        if pause is Pause.CONDITION or self._operator_is_due or self.motion.waits_outside:
            return not (self._events or self.interpreter.interrupts.waits_for_time())
        return False

    def _wait_for_wall(self, seconds: float) -> None:
        self._wall_s = max(self._wall_s + seconds, time.monotonic() - 0.1)
        while (left := self._wall_s - time.monotonic()) > 0:
            self.eki.poll(left)
        self.eki.poll()

    def schedule(self, seconds: float, action: Callable[[], None]) -> None:
        """Do something after so much virtual time."""
        heapq.heappush(self._events, (self.clock.now_s + seconds, next(self._event_numbers), action))

    def forget_events(self) -> None:
        """Drop what is scheduled."""
        self._events.clear()

    @property
    def quota(self) -> int:
        """How many operations fit into a tick."""
        return max(1, round(INTERPOLATION_TICK_S / self.statement_s))

    # --- what functions of KRL need -----------------------------------------------------------------------------

    def expect_network(self) -> None:
        """Note that the program waits for the network: idle time passes as on the wall until something comes."""
        self._network_is_due = True

    def expect_operator(self, *, waits: bool) -> None:
        """Note whether the program waits for the operator, whose time is that on the wall."""
        self._operator_is_due = waits

    def open_channel(self, name: str) -> EkiStatus:
        """Open an EKI channel; a client waits for its server, and time goes on meanwhile."""
        began = time.monotonic()
        status = self.eki.open(name)
        waited = time.monotonic() - began
        self.clock.now_s += waited
        self.motion.step(waited)
        return status

    def halt(self, a: Activation) -> None:
        """HALT."""
        del a
        self.end("halted", RunMessage.HALT, "HALT")

    def end(self, status: str, number: int, text: str) -> None:
        """Let the program stop before its next statement; from any thread.  The first reason counts."""
        if self.ending is None:
            self.ending = Ending(status, int(number), text)
        self.interpreter.stops = True

    def begin(self) -> None:
        """Let the program run: nothing holds it."""
        self.ending = None
        self.interpreter.stops = False

    def command(self, command: str) -> bool:
        """Carry out a command to the robot interpreter; starting a program is the business of `SoftwareKrc.run`."""
        word, _, number = command.strip().upper().partition(" ")
        if word not in _COMMANDS or number.strip() not in {"", "1"}:
            return False
        self.end(_COMMANDS[word], RunMessage.CANCELLED, f"{command} by CWRITE")
        return True

    def confirm(self, message: Value) -> None:
        """CONFIRM: acknowledge one message, or all."""
        if isinstance(message, int) and message:
            self.messages.clear(message)
        else:
            self.messages.acknowledge_all()

    def set_error(self, error: KrlError, file: str, line: int, routine: str) -> None:
        """Set $ERR, for ON_ERROR_PROCEED."""
        self.error_text = error.text
        self.system.set_error(error.number, file.rsplit("/", maxsplit=1)[-1].partition(".")[0], line, routine)

    def clear_error(self) -> None:
        """Reset $ERR."""
        self.error_text = ""
        self.system.clear_error()

    def data_or_none(self, name: str) -> Value:
        """Return global data, None if it is not declared or was never set."""
        place = self.project.find(name, None)
        return None if place is None else place.value

    def variable_state(self, name: str) -> str:
        """Return DECLARED, INITIALIZED or UNKNOWN, for VARSTATE."""
        module = None
        stack = self._running.stack
        if stack:
            stem = stack[-1].code.file.rsplit("/", maxsplit=1)[-1].rpartition(".")[0].upper()
            module = self.project.modules.get(stem)
            base = name.upper().partition("[")[0].partition(".")[0].strip()
            for position, (variable, _) in enumerate(stack[-1].code.variables):
                if variable == base:
                    return _state_of(stack[-1].cells[position].value)
        compiler = ExpressionCompiler(self.project, module, Code("", ""))
        node = _expression(name)
        if node is None:
            return "UNKNOWN"
        try:
            return _state_of(compiler.place(node)(Activation(compiler.code, [])).value)
        except KrlError as error:
            return "DECLARED" if error.number in _WITHOUT_VALUE else "UNKNOWN"

    def evaluate_text(self, content: str) -> Value:
        """Return the value of an expression given as a text.  Raises KrlError."""
        node = _expression(content)
        if node is None:
            raise KrlError(RunMessage.SYNTAX, f"{content} is no value")
        compiler = ExpressionCompiler(self.project, None, Code("", ""))
        return compiler.expr(node)[0](Activation(compiler.code, []))


_WITHOUT_VALUE = frozenset({RunMessage.VALUE_INVALID, RunMessage.TOOL_MISSING})


def _state_of(value: Value) -> str:
    if isinstance(value, CharArray):
        return "INITIALIZED" if value.text is not None else "DECLARED"
    if isinstance(value, StructValue):
        return "INITIALIZED" if value.fields else "DECLARED"
    return "DECLARED" if value is None else "INITIALIZED"


def _expression(content: str) -> Expr | None:
    module = parse(f"DEF X()\nX={content}\nEND\n", "text")
    if module.diagnostics or not module.routines or len(module.routines[0].body) != 1:
        return None
    statement = module.routines[0].body[0]
    return statement.value if isinstance(statement, Assign) else None
