"""How does a program run?  Operation after operation, with interrupts, RESUME and ON_ERROR_PROCEED, tick by tick."""

from collections.abc import Callable

from slabcell_drivers.krc.cells import Cell, Place
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.code import Activation, Code, Function, InterruptEntry, Pause
from slabcell_drivers.krc.compile_routines import RoutineCompiler
from slabcell_drivers.krc.cyclic_value import CyclicValue
from slabcell_drivers.krc.host import Host
from slabcell_drivers.krc.interrupts import Interrupts
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion_orders import TriggerOrder
from slabcell_drivers.krc.motion_runner import MotionRunner
from slabcell_drivers.krc.names import ModuleNames, ProjectNames
from slabcell_drivers.krc.syntax import Routine
from slabcell_drivers.krc.values import Value

__all__ = ["Interpreter"]

MAX_CALL_DEPTH = 200
MAX_CONDITION_OPERATIONS = 1000
_WRONG_VALUES = (TypeError, ValueError, ArithmeticError, AttributeError, LookupError)
"""What functions raise that take a value for what it is not: the program's fault, and an error of its statement."""
LOWEST_PRIORITY = 81  # of triggers that leave the choice to the controller


def _never(_: Activation) -> Value:
    return False


StatementHook = Callable[[str, int], None]


class Interpreter:
    """Runs one program.  The host owns time, I/O and motion and calls `run_slice` once every tick."""

    def __init__(
        self, host: Host, project: ProjectNames, motion: MotionRunner, clock: Clock, *, may_move: bool = True
    ) -> None:
        self.may_move = may_move  # the submit interpreter may not, and waits for no motion
        self.host = host
        self.project = project
        self.motion = motion
        self.clock = clock
        self.stack: list[Activation] = []
        self.interrupts = Interrupts(self._level_of)
        self.statements = 0
        self.on_statement: StatementHook | None = None
        self.stops = False  # set from any thread: nothing is executed from now on
        self._codes: dict[int, Code] = {}
        self._routines: list[Routine] = []  # kept alive, so that an id stands for one routine
        self._cycflags: dict[int, tuple[Function, Activation]] = {}
        self._assignments: dict[int, tuple[Place, CyclicValue]] = {}
        self._proceed: tuple[Activation, list[int]] | None = None
        self._braking = False
        self._is_evaluating = False  # a condition beside the program
        self._stopped_before: tuple[str, int] | None = None

    # --- programs and routines ----------------------------------------------------------------------------------

    def resolve(self, name: str, module: ModuleNames) -> tuple[Routine, ModuleNames] | None:
        """Return the KRL routine that a name means in a module, None where it means one of the controller's own."""
        return self.project.routine(name, module)

    def code_of(self, routine: Routine, module: ModuleNames) -> Code:
        """Return the compiled routine."""
        code = self._codes.get(id(routine))
        if code is None:
            code = RoutineCompiler(self, module, routine, file=module.file_of(routine)).compile()
            self._codes[id(routine)] = code
            self._routines.append(routine)
        return code

    def select(self, routine: Routine, module: ModuleNames) -> None:
        """Begin with a routine: nothing of an earlier program is left."""
        self.deselect()
        code = self.code_of(routine, module)
        self.stack.append(Activation(code, code.cells([])))

    def deselect(self) -> None:
        """Leave everything."""
        self.stack.clear()
        self.interrupts.clear()
        self._cycflags.clear()
        self._assignments.clear()
        self._proceed = None
        self._braking = False

    @property
    def is_done(self) -> bool:
        """Tell whether the program has come to its end."""
        return not self.stack

    @property
    def place(self) -> tuple[str, int]:
        """File and line of the statement that is executed."""
        if self._stopped_before is not None:
            return self._stopped_before
        if not self.stack:
            return "", 0
        top = self.stack[-1]
        position = max(0, min(top.pc, len(top.code.lines)) - 1)
        return top.code.file, top.code.lines[position] if top.code.lines else 0

    # --- execution ----------------------------------------------------------------------------------------------

    def run_slice(self, quota: int) -> Pause | None:
        """Execute up to so many operations; return why it stopped before, None if it did not.  Raises KrlError."""
        stack = self.stack
        hook = self.on_statement
        self._stopped_before = None
        count = 0
        try:
            while count < quota and stack:
                top = stack[-1]
                pc = top.pc
                if hook is not None:
                    hook(top.code.file, top.code.lines[pc])
                    if self.stops:  # whoever watches the statements ended the program before this one
                        self._stopped_before = (top.code.file, top.code.lines[pc])
                        return Pause.CONDITION
                top.pc = pc + 1
                count += 1
                try:
                    pause = top.code.operations[pc](top)
                except KrlError as error:
                    if self._proceed is None or not self._proceeds(top, pc, error):
                        raise
                    continue
                except _WRONG_VALUES as wrong:
                    error = KrlError(RunMessage.TYPE, f"a value of the wrong kind: {wrong}")
                    if self._proceed is None or not self._proceeds(top, pc, error):
                        raise error from wrong
                    continue
                if pause is not None:
                    count -= 1
                    return pause
                if self.stops:
                    return Pause.CONDITION
        finally:
            self.statements += count
        return None

    def enter(self, code: Code, arguments: list[Place], result: Place | None) -> None:
        """Call a routine.  Raises KrlError if the calls are nested too deeply."""
        if len(self.stack) >= MAX_CALL_DEPTH:
            raise KrlError(RunMessage.CALL_DEPTH, f"more than {MAX_CALL_DEPTH} calls within each other")
        self.stack.append(Activation(code, code.cells(arguments), result=result))

    def leave(self, value: Value) -> None:
        """Return from the routine, or from the action of an interrupt."""
        top = self.stack.pop()
        if top.result is not None:
            if value is None:
                raise KrlError(RunMessage.NO_RESULT, f"{top.code.name} returns no value")
            top.result.set(value)
        if top.served is not None:
            self.interrupts.look_again(top.served)
            self._end_of_service()
        else:
            self.interrupts.forget(top)

    def evaluate(self, a: Activation, pc: int) -> Value:
        """Return the value of a condition that calls functions.  Raises KrlError, also if one of them waits."""
        depth = len(self.stack)
        result = Cell("", None)
        self.stack.append(Activation(a.code, a.cells, pc=pc, result=result))
        outer, self._is_evaluating = self._is_evaluating, True
        try:
            for _ in range(MAX_CONDITION_OPERATIONS):
                top = self.stack[-1]
                top.pc += 1
                if top.code.operations[top.pc - 1](top) is not None:
                    break
                if len(self.stack) == depth:
                    return result.value
        finally:
            self._is_evaluating = outer
            del self.stack[depth:]
        text = f"a function in a condition waits, or takes more than {MAX_CONDITION_OPERATIONS} operations"
        raise KrlError(RunMessage.NOT_SUPPORTED, text)

    def proceed_on_error(self, a: Activation, span: list[int]) -> None:
        """Let an error of the next statement set $ERR instead of stopping the program."""
        self._proceed = (a, span)
        self.host.clear_error()

    def _proceeds(self, top: Activation, pc: int, error: KrlError) -> bool:
        assert self._proceed is not None  # noqa: S101  # the caller looked
        activation, (start, line_end, end) = self._proceed
        if activation not in self.stack:
            return False
        depth = self.stack.index(activation)
        # in a routine that the statement called, the caller stands behind its call operation
        position = pc if activation is top else activation.pc - 1
        if not start <= position < line_end:
            return False
        self.host.set_error(error, *self.place, top.code.name)
        del self.stack[depth + 1 :]
        activation.pc = end
        self._proceed = None
        return True

    def end_waits(self, a: Activation) -> bool:
        """Tell whether the program has to wait at its end, because the arm still moves."""
        if self.may_move and len(self.stack) == 1 and self.motion.is_busy:
            a.pc -= 1
            return True
        return False

    def synchronize(self, a: Activation) -> Pause | None:
        """Wait until the main run has caught up: the stop of the advance run.

        An interrupt routine waits for its own motions only, not for those that it interrupted.
        """
        if self._is_evaluating or not self.may_move or not self.motion.is_busy:
            return None
        if self.motion.is_held or not self.served_priority:
            a.pc -= 1
            return Pause.MOTION
        return None

    # --- interrupts ---------------------------------------------------------------------------------------------

    def _level_of(self, activation: Activation) -> int | None:
        for level, found in enumerate(self.stack):
            if found is activation:
                return level
        return None

    @property
    def served_priority(self) -> int:
        """The number of the interrupt that is being served, 0 if there is none."""
        for activation in reversed(self.stack):
            if activation.served is not None:
                return activation.served.number or 1
        return 0

    def check_interrupts(self) -> None:
        """Begin to serve the most important interrupt whose condition has become true."""
        for number, (function, activation) in self._cycflags.items():
            self.host.io.flags.cycflags[number] = function(activation) is True
        for target, cyclic in self._assignments.values():
            if (value := cyclic.now()) is not None:
                target.set(value)
        if self.stack and self.interrupts:
            entry = self.interrupts.due(self.served_priority)
            if entry is not None:
                self.serve(entry, entry.activation, entry.label[0])

    def fire(self, trigger: TriggerOrder) -> None:
        """Run the action of a trigger."""
        number = trigger.priority if trigger.priority > 0 else LOWEST_PRIORITY
        entry = InterruptEntry(number, _never, trigger.activation, trigger.label, is_global=True, uses_time=False)
        self.serve(entry, trigger.activation, trigger.label[0])

    def serve(self, entry: InterruptEntry, activation: Activation, pc: int) -> None:
        """Run the action of an interrupt or trigger before anything else."""
        action = Activation(activation.code, activation.cells, pc=pc)
        action.served = entry
        self.stack.append(action)

    def _end_of_service(self) -> None:
        if self._braking and not self.served_priority:
            self._braking = False
            self.motion.release()

    def brake(self, *, fast: bool) -> None:
        """Stop the motion.  Raises KrlError outside of an interrupt."""
        if not self.served_priority:
            raise KrlError(RunMessage.RESUME, "BRAKE stands outside of an interrupt routine")
        self._braking = True
        self.motion.brake(fast=fast)

    def resume(self) -> None:
        """Leave the interrupt and all routines down to the one that declared it.  Raises KrlError where it cannot."""
        serving = next((i for i in range(len(self.stack) - 1, -1, -1) if self.stack[i].served is not None), None)
        if serving is None:
            raise KrlError(RunMessage.RESUME, "RESUME stands outside of an interrupt routine")
        entry = self.stack[serving].served
        if entry is not None and entry.is_global:
            raise KrlError(RunMessage.RESUME_GLOBAL, f"interrupt {entry.number}")
        level = self._level_of(entry.activation) if entry is not None else None
        if level is None or level >= serving - 1:
            raise KrlError(
                RunMessage.RESUME,
                "RESUME not possible: the program is in the routine that declares the interrupt, not in one below it",
            )
        for activation in self.stack[level + 1 :]:
            self.interrupts.forget(activation)
        del self.stack[level + 1 :]
        self._braking = False
        self.motion.discard()

    def assign_cyclically(self, target: Place, cyclic: CyclicValue | None) -> None:
        """Store a value once every tick from now on; None ends it."""
        if cyclic is None:
            self._assignments.pop(id(target), None)
            return
        self._assignments[id(target)] = (target, cyclic)
        if (value := cyclic.now()) is not None:
            target.set(value)

    def set_cycflag(self, number: Value, function: Function, activation: Activation) -> None:
        """Evaluate a cyclic flag from now on, once every tick."""
        self._cycflags[int(number)] = (function, activation)
        self.host.io.flags.cycflags[int(number)] = function(activation) is True
