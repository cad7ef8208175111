"""How is a call compiled?  A function of the controller's own is called where it stands, a KRL routine is entered."""

from collections.abc import Callable, Iterable

from slabcell_drivers.krc.argument_types import Misfit, builtin_misfits, misfits
from slabcell_drivers.krc.cells import Cell, Place
from slabcell_drivers.krc.code import Activation, Pause
from slabcell_drivers.krc.compile_expressions import Typed
from slabcell_drivers.krc.emitter import StatementEmitter
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.syntax import Call, Expr
from slabcell_drivers.krc.values import Value, copy_value

__all__ = ["CallCompiler"]


def _refuse(node: Call, found: Iterable[Misfit]) -> None:
    for misfit in found:
        raise KrlError(RunMessage.ARGUMENT_TYPE, f"{node.name}(): {misfit}")


def _hand_over(parameter: Cell, value: Value, routine: str) -> None:
    """Store an argument whose type was not known before the program ran."""
    try:
        parameter.set(value)
    except KrlError as error:
        if error.number != RunMessage.ASSIGNMENT:
            raise
        raise KrlError(RunMessage.ARGUMENT_TYPE, f"{routine}({parameter.name}): {error.detail}") from None


class CallCompiler(StatementEmitter):
    """Compiles calls."""

    def call(self, node: Call) -> Typed:
        """Return a function call: one of the controller's own as it is, one in KRL through an operation before it."""
        target = self.interpreter.resolve(node.name, self.scope)
        if target is None:
            return self._builtin(node)
        routine, module = target
        if not routine.result_type:
            raise KrlError(RunMessage.NO_RESULT, f"{node.name} is no function and has no value")
        type_ = None if routine.result_is_array else self.project.find_type(routine.result_type, module)
        index = self.add_local("", type_)
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
        _refuse(node, builtin_misfits(node, self.names))
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

    def compile_call(self, node: Call) -> None:
        """Compile a call that stands as a statement."""
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

        self.emit(wait)

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
        _refuse(node, misfits(node, routine, module, self.names))
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
                        _hand_over(cell, value, node.name)
                arguments.append(cell)
            interpreter.enter(code, arguments, None if result is None else a.cells[result])

        self.emit_synchronized(call)
