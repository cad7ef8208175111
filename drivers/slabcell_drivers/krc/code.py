"""What does the interpreter execute?  A routine as a flat list of operations, and the activation of one.

Every operation is a closure over the variables it works on.  It returns None when it is done, or a `Pause` when it has
to be tried again once something has happened; so a program can stand still, be interrupted, be cancelled or lose its
power between any two operations, and no Python stack grows with KRL's.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from slabcell_drivers.krc.cells import Cell, Place
from slabcell_drivers.krc.values import KrlType, Value

__all__ = ["Activation", "Code", "Function", "InterruptEntry", "Operation", "Pause"]


class Pause(Enum):
    """Why an operation did not finish."""

    MOTION = "motion"  # the main run has to catch up
    TIME = "time"  # a moment has to come
    CONDITION = "condition"  # something outside of time has to happen: an input, a telegram


Function = Callable[["Activation"], Value]
Operation = Callable[["Activation"], Pause | None]


@dataclass(slots=True)
class Code:
    """A routine, ready to run.  ``lines[i]`` is the line of the file that operation ``i`` comes from."""

    name: str
    file: str
    operations: list[Operation] = field(default_factory=list[Operation])
    lines: list[int] = field(default_factory=list[int])
    variables: list[tuple[str, KrlType | None]] = field(default_factory=list[tuple[str, KrlType | None]])
    parameter_count: int = 0
    has_result: bool = False

    def cells(self, arguments: list[Place]) -> list[Place]:
        """Return the variables of a new activation: the arguments first, then everything else, fresh."""
        return arguments + [Cell(name, type_) for name, type_ in self.variables[len(arguments) :]]


class Activation:
    """A routine that is being executed."""

    __slots__ = ("cells", "code", "pc", "result", "served", "wait_until")

    def __init__(self, code: Code, cells: list[Place], *, pc: int = 0, result: Place | None = None) -> None:
        self.code = code
        self.cells = cells
        self.pc = pc
        self.result = result  # where the caller wants the value of a function
        self.served: InterruptEntry | None = None  # the interrupt that this activation serves
        self.wait_until: float | None = None  # of a WAIT SEC that has begun

    @property
    def line(self) -> int:
        """The line that is executed."""
        lines = self.code.lines
        return lines[min(self.pc, len(lines) - 1)] if lines else 0


@dataclass(slots=True, eq=False)
class InterruptEntry:
    """One declared interrupt."""

    number: int
    condition: Function
    activation: Activation
    label: list[int]
    is_global: bool
    uses_time: bool
    is_on: bool = False
    is_enabled: bool = True
    was_true: bool = False
    is_pending: bool = False
