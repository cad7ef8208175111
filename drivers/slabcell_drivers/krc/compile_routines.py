"""How does a routine become operations?  Blocks become jumps, calls of KRL functions operations of their own."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from slabcell_drivers.krc.cells import Cell, Place, Trait
from slabcell_drivers.krc.code import Activation, Code, Operation, Pause
from slabcell_drivers.krc.compile_expressions import ExpressionCompiler, Typed, describe
from slabcell_drivers.krc.compile_motion import compile_motion, compile_spline, compile_trigger
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.operators import BINARY
from slabcell_drivers.krc.syntax import (
    Analog,
    Assign,
    Asynchronous,
    Call,
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
from slabcell_drivers.krc.values import INT, KrlType, Value, copy_value

if TYPE_CHECKING:
    from slabcell_drivers.krc.interpreter import Interpreter
    from slabcell_drivers.krc.scope import ModuleScope

__all__ = ["RoutineCompiler"]


class RoutineCompiler(ExpressionCompiler):
    """Compiles one routine for one interpreter."""

    def __init__(self, interpreter: "Interpreter", module: "ModuleScope", routine: Routine, *, file: str) -> None:
        code = Code(routine.name, file, has_result=bool(routine.result_type))
        super().__init__(interpreter.project, module, code)
        self.scope = module
        self.interpreter = interpreter
        self.routine = routine
        self._line = routine.place.line
        self._exits: list[list[int]] = []
        self._labels: dict[str, int] = {}
        self._gotos: list[tuple[int, str, int]] = []
        self._actions: list[tuple[list[int], Statement, int]] = []
        self._proceeds: list[list[int]] = []
        self._continues = False
        self._is_action = False  # of an interrupt or trigger: belongs to the main run

    def compile(self) -> Code:
        """Return the operations of the routine.  What cannot be compiled becomes an operation that says so."""
        self._declare_variables()
        self._block(self.routine.body)
        self._line = self.routine.end.line
        self._emit(self._end)
        self._is_action = True
        for label, action, line in self._actions:
            self._line = line
            label[0] = len(self.code.operations)
            self._statement(action)
            self._emit(self._end_of_action)
        for position, name, line in self._gotos:
            target = self._labels.get(name)
            self._line = line
            if target is None:
                self.code.operations[position] = _failing(RunMessage.UNDECLARED, f"label {name} is not in this routine")
            else:
                self.code.operations[position] = _jump(target)
        return self.code

    # --- variables ----------------------------------------------------------------------------------------------

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
            self._add_local(parameter.name, type_)
        self.code.parameter_count = len(self.routine.parameters)
        for name, type_ in types.items():
            self._add_local(name, type_)

    def _add_local(self, name: str, type_: KrlType | None) -> int:
        index = len(self.code.variables)
        self.code.variables.append((name, type_))
        if name:
            self.locals[name] = index
            self.local_types[name] = type_
        return index

    # --- emitting -----------------------------------------------------------------------------------------------

    @property
    def position(self) -> int:
        """Where the next operation will stand."""
        return len(self.code.operations)

    def _emit(self, operation: Operation) -> int:
        self.code.operations.append(operation)
        self.code.lines.append(self._line)
        return len(self.code.operations) - 1

    def emit_synchronized(self, operation: Operation, *, always: bool = False) -> int:
        """Emit an operation, before it a stop of the advance run if it needs one and no CONTINUE stands before it."""
        if (always or Trait.STOPS_ADVANCE in self.traits) and not (self._continues or self._is_action):
            self._emit(self.interpreter.synchronize)
        return self._emit(operation)

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

    # --- statements ---------------------------------------------------------------------------------------------

    def _block(self, statements: Sequence[Statement]) -> None:
        for statement in statements:
            self._statement(statement)

    def _statement(self, statement: Statement) -> None:
        self._line = statement.place.line
        start = self.position
        proceeds, self._proceeds = self._proceeds, []
        continues = self._continues
        self.traits.clear()
        try:
            self._compile(statement)
        except KrlError as error:
            self._emit(_failing(error.number, error.text))
        if continues:
            self._continues = False
        for span in proceeds:
            span[:] = [start, self.position]

    def _compile(self, statement: Statement) -> None:
        match statement:
            case Assign():
                self._assign(statement)
            case CallStatement(call=call):
                self._call_statement(call)
            case If():
                self._if(statement)
            case Switch():
                self._switch(statement)
            case For():
                self._for(statement)
            case While(condition=condition, body=body):
                self._loop(body, before=condition)
            case Repeat(condition=condition, body=body):
                self._loop(body, after=condition)
            case Loop(body=body):
                self._loop(body)
            case Goto(label=label):
                self._gotos.append((self._emit(_jump(0)), label, self._line))
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
                self._emit(_failing(RunMessage.NOT_SUPPORTED, f"{verb}: this robot has no external axes"))
            case SplineCondition() | Signal() | Struct() | EnumDecl() | External() | Import() | Channel():
                pass

    def action(self, statement: Statement) -> list[int]:
        """Compile what an interrupt or trigger does; the list holds its position once the routine is complete."""
        label = [0]
        self._actions.append((label, statement, self._line))
        return label

    def block(self, statements: Sequence[Statement]) -> None:
        """Compile statements in their order."""
        self._block(statements)

    def _initial_values(self, statement: Declaration) -> None:
        for declarator in statement.names:
            if declarator.value is not None and declarator.name in self.locals:
                self._assign(Assign(statement.place, Name(declarator.place, declarator.name), declarator.value))

    def _assign(self, statement: Assign) -> None:
        target = statement.target
        function, _ = self.expr(statement.value)
        if isinstance(target, Index) and isinstance(target.base, Name) and target.base.name == "$CYCFLAG":
            number = self.expr(target.indices[0])[0] if target.indices[0] is not None else None
            if number is None:
                raise KrlError(RunMessage.INDEX, "$CYCFLAG needs an index")
            self._emit(lambda a: self.interpreter.set_cycflag(number(a), function, a))
            return
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
                if error.number == RunMessage.INDEX and not error.text.startswith(text):
                    raise KrlError(error.number, f"{text}: {error.text}") from None
                raise

        self.emit_synchronized(set_part)

    def _if(self, statement: If) -> None:
        condition = self.expr(statement.condition)[0]
        branch = self.emit_synchronized(_jump(0))
        self._block(statement.then)
        if statement.otherwise:
            self._line = statement.place.line
            skip = self._emit(_jump(0))
            self.code.operations[branch] = _branch(condition, self.position)
            self._block(statement.otherwise)
            self.code.operations[skip] = _jump(self.position)
        else:
            self.code.operations[branch] = _branch(condition, self.position)

    def _switch(self, statement: Switch) -> None:
        subject = self.expr(statement.subject)[0]
        choices = [[self.expr(value)[0] for value in case.values] for case in statement.cases]
        chooser = self.emit_synchronized(_jump(0))
        targets: list[int] = []
        ends: list[int] = []
        for case in statement.cases:
            targets.append(self.position)
            self._block(case.body)
            self._line = case.place.line
            ends.append(self._emit(_jump(0)))
        end = self.position
        for position in ends:
            self.code.operations[position] = _jump(end)
        equal = BINARY["=="]
        table = [(values, target) for values, target in zip(choices, targets, strict=True) if values]
        default = next((t for values, t in zip(choices, targets, strict=True) if not values), end)

        def choose(a: Activation) -> None:
            value = subject(a)
            for values, target in table:
                if any(equal(value, candidate(a)) for candidate in values):
                    a.pc = target
                    return
            a.pc = default

        self.code.operations[chooser] = choose

    def _for(self, statement: For) -> None:
        variable = self.place(statement.variable)
        start, end = self.expr(statement.start)[0], self.expr(statement.end)[0]
        step = self.expr(statement.step)[0] if statement.step is not None else None
        end_index, step_index = self._add_local("", INT), self._add_local("", INT)
        first = self.emit_synchronized(_jump(0))
        body = self.position
        self._exits.append([])
        self._block(statement.body)
        self._line = statement.place.line
        repeat = self._emit(_jump(0))
        after = self.position

        def begin(a: Activation) -> None:
            place = variable(a)
            place.set(start(a))
            limit, stride = end(a), 1 if step is None else step(a)
            a.cells[end_index].set(limit)
            a.cells[step_index].set(stride)
            if (place.value > limit) if stride > 0 else (place.value < limit):
                a.pc = after

        def go_on(a: Activation) -> None:
            place = variable(a)
            stride, limit = a.cells[step_index].value, a.cells[end_index].value
            place.set(place.value + stride)
            if (place.value <= limit) if stride > 0 else (place.value >= limit):
                a.pc = body

        self.code.operations[first] = begin
        self.code.operations[repeat] = go_on
        self._patch_exits()

    def _loop(self, body: Sequence[Statement], *, before: Expr | None = None, after: Expr | None = None) -> None:
        start = self.position
        line = self._line
        check = -1
        condition = None
        if before is not None:
            condition = self.expr(before)[0]
            check = self.emit_synchronized(_jump(0))
        self._exits.append([])
        self._block(body)
        self._line = line
        if after is not None:
            self.traits.clear()
            until = self.expr(after)[0]
            self.emit_synchronized(_branch(until, start))
        else:
            self._emit(_jump(start))
        if condition is not None:
            self.code.operations[check] = _branch(condition, self.position)
        self._patch_exits()

    def _patch_exits(self) -> None:
        for position in self._exits.pop():
            self.code.operations[position] = _jump(self.position)

    def _return(self, statement: Return) -> None:
        leave = self.interpreter.leave
        if statement.value is None:
            self._emit(self._end_of_procedure)
            return
        function = self.expr(statement.value)[0]
        self.emit_synchronized(lambda a: leave(function(a)))

    def _keyword(self, word: str) -> None:
        interpreter = self.interpreter
        match word:
            case "EXIT":
                if not self._exits:
                    raise KrlError(RunMessage.SYNTAX, "EXIT stands in no loop")
                self._exits[-1].append(self._emit(_jump(0)))
            case "HALT":
                self.emit_synchronized(interpreter.host.halt, always=True)
            case "CONTINUE":
                self._continues = True
            case "RESUME":
                self._emit(lambda _: interpreter.resume())
            case "BRAKE" | "BRAKE F":
                self._emit(lambda _: interpreter.brake(fast=word.endswith("F")))
            case _:
                span = [0, 0]
                self._emit(lambda a: interpreter.proceed_on_error(a, span))
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
        condition = self.expr(statement.condition)[0]
        uses_time = Trait.TIME in self.traits
        label = self.action(statement.action)
        interrupts = self.interpreter.interrupts
        is_global = statement.is_global
        self._emit(lambda a: interrupts.declare(number(a), condition, a, label, is_global=is_global, time=uses_time))

    def _interrupt(self, statement: Interrupt) -> None:
        number = self.expr(statement.number)[0] if statement.number is not None else None
        interrupts, verb = self.interpreter.interrupts, statement.verb
        self._emit(lambda a: interrupts.switch(verb, number(a) if number is not None else None))

    def _analog(self, statement: Analog) -> None:
        if statement.verb == "OFF" or statement.value is None:
            return
        self._assign(Assign(statement.place, statement.target, statement.value))

    # --- calls --------------------------------------------------------------------------------------------------

    def call(self, node: Call) -> Typed:
        """Return a function call: one of the controller's own as it is, one in KRL through an operation before it."""
        target = self.interpreter.resolve(node.name, self.scope)
        if target is None:
            return self._builtin(node)
        routine, module = target
        if not routine.result_type:
            raise KrlError(RunMessage.NO_RESULT, f"{node.name} is no function and has no value")
        type_ = None if routine.result_is_array else self.project.find_type(routine.result_type, module)
        index = self._add_local("", type_)
        self._call_operation(node, result=index)

        def load(a: Activation) -> Value:
            return a.cells[index].value

        return load, type_

    def _builtin(self, node: Call) -> Typed:
        builtin = self.project.builtins.get(node.name)
        if builtin is None:
            raise KrlError(RunMessage.UNDECLARED, f"{node.name}() is not declared")
        if len(node.arguments) < builtin.least or len(node.arguments) > builtin.most:
            raise KrlError(
                RunMessage.ARGUMENTS,
                f"{node.name}() takes {builtin.least} to {builtin.most} arguments, {len(node.arguments)} given",
            )
        binders: list[Callable[[Activation], Value] | None] = []
        for position, argument in enumerate(node.arguments):
            if argument is None:
                binders.append(None)
            elif position in builtin.outs or (builtin.rest_out and position >= min(builtin.outs, default=0)):
                binders.append(self._out_binder(argument))
            else:
                binders.append(self.expr(argument)[0])
        function, host = builtin.function, self.interpreter.host
        self.traits |= builtin.traits
        type_ = self.project.find_type(builtin.result, None) if builtin.result else None
        return (lambda a: function(host, *[None if b is None else b(a) for b in binders])), type_

    def _out_binder(self, argument: Expr) -> Callable[[Activation], Place]:
        try:
            return self.place(argument)
        except KrlError as error:
            if error.number != RunMessage.ARGUMENTS:
                raise
        function = self.expr(argument)[0]

        def temporary(a: Activation) -> Place:
            cell = Cell("argument", None)
            cell.value = copy_value(function(a))
            return cell

        return temporary

    def _call_statement(self, node: Call) -> None:
        if self.interpreter.resolve(node.name, self.scope) is not None:
            self._call_operation(node, result=None)
            return
        function = self._builtin(node)[0]

        def call_builtin(a: Activation) -> None:
            function(a)

        self.emit_synchronized(call_builtin)
        waits, host = self.project.builtins[node.name].waits, self.interpreter.host
        if waits is None:
            return

        def wait(a: Activation) -> Pause | None:
            if waits(host):
                return None
            a.pc -= 1
            return Pause.TIME

        self._emit(wait)

    def _call_operation(self, node: Call, *, result: int | None) -> None:
        target = self.interpreter.resolve(node.name, self.scope)
        if target is None:
            raise KrlError(RunMessage.UNDECLARED, f"{node.name}() is not declared")
        routine, module = target
        if len(node.arguments) > len(routine.parameters):
            raise KrlError(
                RunMessage.ARGUMENTS,
                f"{node.name}() takes {len(routine.parameters)} arguments, {len(node.arguments)} given",
            )
        binders: list[tuple[bool, Callable[[Activation], Value]] | None] = []
        for position, parameter in enumerate(routine.parameters):
            argument = node.arguments[position] if position < len(node.arguments) else None
            if argument is None:
                binders.append(None)
            elif parameter.mode == "IN":
                binders.append((True, self.expr(argument)[0]))
            else:
                binders.append((False, self._out_binder(argument)))
        interpreter = self.interpreter

        def call(a: Activation) -> None:
            code = interpreter.code_of(routine, module)
            arguments: list[Place] = []
            for position, binder in enumerate(binders):
                name, type_ = code.variables[position]
                if binder is not None and not binder[0]:
                    arguments.append(binder[1](a))
                    continue
                cell = Cell(name, type_)
                if binder is not None:
                    value = binder[1](a)
                    if type_ is None:
                        cell.value = copy_value(value)
                    else:
                        cell.set(value)
                arguments.append(cell)
            interpreter.enter(code, arguments, None if result is None else a.cells[result])

        self.emit_synchronized(call)


def _jump(target: int) -> Operation:
    def jump(a: Activation) -> None:
        a.pc = target

    return jump


def _branch(condition: Callable[[Activation], Value], target: int) -> Operation:
    def branch(a: Activation) -> None:
        value = condition(a)
        if value is False:
            a.pc = target
        elif value is not True:
            raise KrlError(RunMessage.TYPE, "the condition is no BOOL")

    return branch


def _failing(number: int, text: str) -> Operation:
    def fail(_: Activation) -> None:
        raise KrlError(number, text)

    return fail
