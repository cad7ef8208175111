"""How do operations line up in a routine, and where does the advance run have to wait between them?"""

from abc import abstractmethod
from collections.abc import Sequence

from slabcell_drivers.krc.cells import Trait
from slabcell_drivers.krc.code import Code, Function, Operation
from slabcell_drivers.krc.compile_expressions import ExpressionCompiler
from slabcell_drivers.krc.machine import Machine
from slabcell_drivers.krc.names import ModuleNames
from slabcell_drivers.krc.syntax import Expr, Statement
from slabcell_drivers.krc.values import KrlType

__all__ = ["Emitter", "StatementEmitter"]


class Emitter(ExpressionCompiler):
    """Collects the operations and variables of one routine."""

    def __init__(self, interpreter: Machine, module: ModuleNames, code: Code, *, line: int) -> None:
        super().__init__(interpreter.project, module, code)
        self.scope = module
        self.interpreter = interpreter
        self.line = line
        self.continues = False  # CONTINUE stands before the statement
        self.is_action = False  # of an interrupt or trigger: belongs to the main run

    def add_local(self, name: str, type_: KrlType | None) -> int:
        """Add a variable, one without a name for a value between operations; return its index."""
        index = len(self.code.variables)
        self.code.variables.append((name, type_))
        if name:
            self.locals[name] = index
            self.local_types[name] = type_
        return index

    @property
    def position(self) -> int:
        """Where the next operation will stand."""
        return len(self.code.operations)

    def emit(self, operation: Operation) -> int:
        """Add an operation and return its position."""
        self.code.operations.append(operation)
        self.code.lines.append(self.line)
        return len(self.code.operations) - 1

    def emit_synchronized(self, operation: Operation, *, always: bool = False) -> int:
        """Emit an operation, before it a stop of the advance run if it needs one and no CONTINUE stands before it."""
        if (always or Trait.STOPS_ADVANCE in self.traits) and not (self.continues or self.is_action):
            self.emit(self.interpreter.synchronize)
        return self.emit(operation)


class StatementEmitter(Emitter):
    """An emitter that can compile whole statements: what motions and triggers ask of the routine they stand in."""

    @abstractmethod
    def block(self, statements: Sequence[Statement]) -> None:
        """Compile statements in their order."""

    @abstractmethod
    def condition(self, node: Expr) -> Function:
        """Return a condition that is looked at beside the program."""

    @abstractmethod
    def action(self, statement: Statement) -> list[int]:
        """Compile what an interrupt or trigger does; the list holds its position once the routine is complete."""
