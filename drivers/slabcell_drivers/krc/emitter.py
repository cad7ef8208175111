"""How do operations line up in a routine, and where does the advance run have to wait between them?"""

from typing import TYPE_CHECKING

from slabcell_drivers.krc.cells import Trait
from slabcell_drivers.krc.code import Code, Operation
from slabcell_drivers.krc.compile_expressions import ExpressionCompiler
from slabcell_drivers.krc.values import KrlType

if TYPE_CHECKING:
    from slabcell_drivers.krc.interpreter import Interpreter
    from slabcell_drivers.krc.scope import ModuleScope

__all__ = ["Emitter"]


class Emitter(ExpressionCompiler):
    """Collects the operations and variables of one routine."""

    def __init__(self, interpreter: "Interpreter", module: "ModuleScope", code: Code, *, line: int) -> None:
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
