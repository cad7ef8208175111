"""How does a routine become operations?  Variables, statements, and what interrupts and triggers do."""

from collections.abc import Sequence
from functools import partial

from slabcell_drivers.krc.cells import Trait
from slabcell_drivers.krc.code import Activation, Code, Function, Pause
from slabcell_drivers.krc.compile_blocks import BlockCompiler
from slabcell_drivers.krc.compile_expressions import describe
from slabcell_drivers.krc.compile_motion import compile_motion, compile_path_order, compile_spline, compile_trigger
from slabcell_drivers.krc.cyclic_value import CyclicOptions, CyclicValue
from slabcell_drivers.krc.jumps import failing, jump_to
from slabcell_drivers.krc.machine import Machine
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.names import ModuleNames
from slabcell_drivers.krc.syntax import (
    Analog,
    Assign,
    Asynchronous,
    CallStatement,
    Channel,
    Confirm,
    Declaration,
    EnumDecl,
    Expr,
    External,
    For,
    Goto,
    If,
    Import,
    Index,
    Interrupt,
    InterruptDecl,
    Keyword,
    Label,
    Loop,
    Motion,
    Name,
    Repeat,
    Return,
    Routine,
    Signal,
    Spline,
    SplineCondition,
    Statement,
    Struct,
    Switch,
    Trigger,
    Wait,
    While,
)
from slabcell_drivers.krc.values import KrlType

__all__ = ["RoutineCompiler"]


class RoutineCompiler(BlockCompiler):
    """Compiles one routine for one interpreter."""

    def __init__(self, interpreter: Machine, module: ModuleNames, routine: Routine, *, file: str) -> None:
        code = Code(routine.name, file, has_result=bool(routine.result_type))
        super().__init__(interpreter, module, code, line=routine.place.line)
        self.routine = routine
        self.exits = []
        self._labels: dict[str, int] = {}
        self._gotos: list[tuple[int, str, int]] = []
        self._actions: list[tuple[list[int], Statement, int]] = []
        self._proceeds: list[list[int]] = []
        self._continue_next = False

    def _cyclic(self, node: Expr, refusal: RunMessage) -> Function:
        """Return an expression that is evaluated every tick: it may call no function written in KRL."""
        before = self.position
        function = self.expr(node)[0]
        if self.position != before:
            raise KrlError(refusal, "it is evaluated cyclically and calls a function written in KRL")
        return function

    def condition(self, node: Expr) -> Function:
        """Return a condition that is looked at beside the program, also where it calls functions written in KRL."""
        skip = self.emit(jump_to(self.position + 1))
        start = self.position
        function = self.expr(node)[0]
        if self.position == start:
            del self.code.operations[skip:], self.code.lines[skip:]
            return function
        interpreter = self.interpreter
        self.emit(lambda a: interpreter.leave(function(a)))
        self.code.operations[skip] = jump_to(self.position)
        return lambda a: interpreter.evaluate(a, start)

    def compile(self) -> Code:
        """Return the operations of the routine.  What cannot be compiled becomes an operation that says so."""
        self._declare_variables()
        self.block(self.routine.body)
        self.line = self.routine.end.line
        self.emit(self._end)
        self.is_action = True
        for label, action, line in self._actions:
            self.line = line
            label[0] = len(self.code.operations)
            self._statement(action)
            self.emit(self._end_of_action)
        for position, name, line in self._gotos:
            target = self._labels.get(name)
            self.line = line
            if target is None:
                self.code.operations[position] = failing(RunMessage.UNDECLARED, f"label {name} is not in this routine")
            else:
                self.code.operations[position] = jump_to(target)
        return self.code

    def _declare_variables(self) -> None:
        types: dict[str, KrlType | None] = {}
        for statement in self.routine.body:
            if isinstance(statement, Declaration):
                for declarator in statement.names:
                    types[declarator.name] = self.project.declared_type(statement.type_name, declarator, self.scope)
            elif isinstance(statement, Signal | Struct | EnumDecl):
                self.project.declare(statement, self.scope)
        for parameter in self.routine.parameters:
            type_ = types.pop(parameter.name, None)
            if type_ is None and parameter.type_name:
                type_ = self.project.find_type(parameter.type_name, self.module)
            self.add_local(parameter.name, type_)
        self.code.parameter_count = len(self.routine.parameters)
        for name, type_ in types.items():
            self.add_local(name, type_)

    def _end(self, a: Activation) -> Pause | None:
        if self.code.has_result:
            raise KrlError(RunMessage.NO_RESULT, f"{self.code.name} ends without RETURN of a value")
        if self.interpreter.end_waits(a):
            return Pause.MOTION
        self.interpreter.leave(None)
        return None

    def _end_of_procedure(self, a: Activation) -> Pause | None:
        if self.interpreter.end_waits(a):
            return Pause.MOTION
        self.interpreter.leave(None)
        return None

    def _end_of_action(self, _: Activation) -> None:
        self.interpreter.leave(None)

    def block(self, statements: Sequence[Statement]) -> None:
        """Compile statements in their order."""
        for statement in statements:
            self._statement(statement)

    def _statement(self, statement: Statement) -> None:
        self.line = statement.place.line
        start = self.position
        proceeds, self._proceeds = self._proceeds, []
        # CONTINUE and ON_ERROR_PROCEED are for the line behind them, not for what stands in its block
        outer = self.continues
        self.continues, self._continue_next = self._continue_next, False
        self.traits.clear()
        try:
            self._compile(statement)
        except KrlError as error:
            self.emit(failing(error.number, error.detail))
        self.continues = outer
        line_end = start
        while line_end < self.position and self.code.lines[line_end] == statement.place.line:
            line_end += 1
        for span in proceeds:
            span[:] = [start, line_end, self.position]

    def _compile(self, statement: Statement) -> None:
        match statement:
            case Assign():
                self._assign(statement)
            case CallStatement(call=call):
                self.compile_call(call)
            case If():
                self.compile_if(statement)
            case Switch():
                self.compile_switch(statement)
            case For():
                self.compile_for(statement)
            case While(condition=condition, body=body):
                self.compile_loop(body, before=condition)
            case Repeat(condition=condition, body=body):
                self.compile_loop(body, after=condition)
            case Loop(body=body):
                self.compile_loop(body)
            case Goto(label=label):
                self._gotos.append((self.emit(jump_to(0)), label, self.line))
            case Label(name=name):
                self._labels[name] = self.position
            case Return():
                self._return(statement)
            case Keyword(word=word):
                self._keyword(word)
            case Wait():
                self._wait(statement)
            case InterruptDecl():
                self._interrupt_decl(statement)
            case Interrupt():
                self._interrupt(statement)
            case Motion():
                compile_motion(self, statement)
            case Spline():
                compile_spline(self, statement)
            case Trigger():
                compile_trigger(self, statement)
            case Declaration():
                self._initial_values(statement)
            case Confirm(value=value):
                function = self.expr(value)[0]
                self.emit_synchronized(lambda a: self.interpreter.host.confirm(function(a)), always=True)
            case Analog():
                self._analog(statement)
            case Asynchronous(verb=verb):
                self.emit(failing(RunMessage.NOT_SUPPORTED, f"{verb}: this robot has no external axes"))
            case SplineCondition():
                compile_path_order(self, statement)
            case Signal() | Struct() | EnumDecl() | External() | Import() | Channel():
                pass

    def action(self, statement: Statement) -> list[int]:
        """Compile what an interrupt or trigger does; the list holds its position once the routine is complete."""
        label = [0]
        self._actions.append((label, statement, self.line))
        return label

    def _initial_values(self, statement: Declaration) -> None:
        for declarator in statement.names:
            if declarator.value is not None and declarator.name in self.locals:
                self._assign(Assign(statement.place, Name(declarator.place, declarator.name), declarator.value))

    def _assign(self, statement: Assign) -> None:
        target = statement.target
        if isinstance(target, Index) and isinstance(target.base, Name) and target.base.name == "$CYCFLAG":
            function = self._cyclic(statement.value, RunMessage.CYCFLAG_FUNCTION)
            number = self.expr(target.indices[0])[0] if target.indices[0] is not None else None
            if number is None:
                raise KrlError(RunMessage.INDEX, "$CYCFLAG needs an index")
            self.emit(lambda a: self.interpreter.set_cycflag(number(a), function, a))
            return
        function, _ = self.expr(statement.value)
        if isinstance(target, Name) and target.name in self.locals:
            index = self.locals[target.name]

            def set_local(a: Activation) -> None:
                a.cells[index].set(function(a))

            self.emit_synchronized(set_local)
            return
        if isinstance(target, Name):
            cell = self.cell(target.name)
            if cell is None:
                raise KrlError(RunMessage.UNDECLARED, f"{target.name} is not declared")
            store = cell.set
            self.emit_synchronized(lambda a: store(function(a)))
            return
        place = self.place(target)
        text = describe(target)

        def set_part(a: Activation) -> None:
            try:
                place(a).set(function(a))
            except KrlError as error:
                if error.number == RunMessage.INDEX and not error.detail.startswith(text):
                    raise KrlError(error.number, f"{text}: {error.detail}") from None
                raise

        self.emit_synchronized(set_part)

    def _return(self, statement: Return) -> None:
        leave = self.interpreter.leave
        if statement.value is None:
            self.emit(self._end_of_procedure)
            return
        function = self.expr(statement.value)[0]
        self.emit_synchronized(lambda a: leave(function(a)))

    def _keyword(self, word: str) -> None:
        interpreter = self.interpreter
        match word:
            case "EXIT":
                if not self.exits:
                    raise KrlError(RunMessage.SYNTAX, "EXIT stands in no loop")
                self.exits[-1].append(self.emit(jump_to(0)))
            case "HALT":
                self.emit_synchronized(interpreter.host.halt, always=True)
            case "CONTINUE":
                self._continue_next = True
            case "RESUME":
                self.emit(lambda _: interpreter.resume())
            case "BRAKE" | "BRAKE F":
                self.emit(lambda _: interpreter.brake(fast=word.endswith("F")))
            case _:
                span = [0, 0, 0]  # first and last operation of the line, and where to go on
                self.emit(lambda a: interpreter.proceed_on_error(a, span))
                self._proceeds = [span]

    def _wait(self, statement: Wait) -> None:
        interpreter = self.interpreter
        start = self.position
        function = self.expr(statement.value)[0]
        if statement.kind == "FOR":
            reason = Pause.TIME if Trait.TIME in self.traits else Pause.CONDITION

            def wait_for(a: Activation) -> Pause | None:
                if function(a) is True:
                    return None
                a.pc = start
                return reason

            self.emit_synchronized(wait_for, always=True)
            return

        def wait_seconds(a: Activation) -> Pause | None:
            now = interpreter.clock.now_s
            until = a.wait_until
            if until is None:
                until = a.wait_until = now + float(function(a))
            if now >= until - 1e-9:
                a.wait_until = None
                return None
            a.pc -= 1
            return Pause.TIME

        self.emit_synchronized(wait_seconds, always=True)

    def _interrupt_decl(self, statement: InterruptDecl) -> None:
        number = self.expr(statement.number)[0]
        self.traits.clear()
        condition = self.condition(statement.condition)
        uses_time = Trait.TIME in self.traits
        label = self.action(statement.action)
        interrupts = self.interpreter.interrupts
        is_global = statement.is_global
        self.emit(lambda a: interrupts.declare(number(a), condition, a, label, is_global=is_global, time=uses_time))

    def _interrupt(self, statement: Interrupt) -> None:
        number = self.expr(statement.number)[0] if statement.number is not None else None
        interrupts, verb = self.interpreter.interrupts, statement.verb
        self.emit(lambda a: interrupts.switch(verb, number(a) if number is not None else None))

    def _analog(self, statement: Analog) -> None:
        """ANIN and ANOUT: a value that follows its expression once every tick, from ON to OFF."""
        target = self.place(statement.target)
        machine = self.interpreter
        if statement.verb != "ON" or statement.value is None:
            self.emit_synchronized(lambda a: machine.assign_cyclically(target(a), None))
            return
        function = self._cyclic(statement.value, RunMessage.NOT_SUPPORTED)
        options = {name: self.expr(value)[0] for name, value in statement.options}

        def option(name: str, a: Activation) -> float | None:
            return float(options[name](a)) if name in options else None

        def begin(a: Activation) -> None:
            delay_s = option("DELAY", a) or 0.0
            if delay_s < 0.0:
                raise KrlError(RunMessage.NOT_SUPPORTED, f"{statement.kind} ON with DELAY={delay_s:g}, before its time")
            given = CyclicOptions(delay_s, option("MINIMUM", a), option("MAXIMUM", a))
            machine.assign_cyclically(target(a), CyclicValue(partial(function, a), machine.clock, given))

        self.emit_synchronized(begin)
