"""What stands in KRL expressions?  Frozen nodes with their place in the file; names are in capitals."""

from __future__ import annotations

from dataclasses import dataclass

from slabcell_drivers.krc.messages import COMPILER_NUMBERS

__all__ = [
    "Aggregate",
    "Binary",
    "Call",
    "Diagnostic",
    "EnumValue",
    "Expr",
    "Index",
    "Literal",
    "Member",
    "Name",
    "Node",
    "Place",
    "Unary",
]


@dataclass(frozen=True, slots=True)
class Place:
    """A place in a file; both counts begin at 1."""

    line: int
    column: int


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One thing that is wrong with a program."""

    file: str
    line: int
    column: int
    severity: str  # "error" or "warning"
    code: str
    message: str

    @property
    def controller_number(self) -> int | None:
        """The number that the controller's compiler has for this, None where it is not known."""
        return COMPILER_NUMBERS.get(self.code)

    def __str__(self) -> str:
        """Return the line that compilers print."""
        number = self.controller_number
        code = self.code if number is None else f"{self.code}, {number}"
        return f"{self.file}:{self.line}:{self.column}: {self.severity}: {self.message} [{code}]"


@dataclass(frozen=True, slots=True)
class Node:
    """Anything that stands somewhere in a file."""

    place: Place


@dataclass(frozen=True, slots=True)
class Literal(Node):
    """INT, REAL, BOOL or text."""

    value: int | float | bool | str


@dataclass(frozen=True, slots=True)
class EnumValue(Node):
    """``#NAME``."""

    name: str


@dataclass(frozen=True, slots=True)
class Name(Node):
    """A variable, or a system variable when it begins with ``$``."""

    name: str


@dataclass(frozen=True, slots=True)
class Index(Node):
    """``x[1]``, ``x[]``, ``x[1,]``: an empty place is None."""

    base: Expr
    indices: tuple[Expr | None, ...]


@dataclass(frozen=True, slots=True)
class Member(Node):
    """``x.NAME``."""

    base: Expr
    name: str


@dataclass(frozen=True, slots=True)
class Call(Node):
    """``f(a,,b)``: an argument left out is None."""

    name: str
    arguments: tuple[Expr | None, ...]


@dataclass(frozen=True, slots=True)
class Aggregate(Node):
    """``{TYPE: A 1,B[] "x",C {…}}``; a member without a name is positional."""

    type_name: str
    members: tuple[tuple[str, Expr], ...]


@dataclass(frozen=True, slots=True)
class Unary(Node):
    """``NOT``, ``B_NOT``, ``+`` or ``-``."""

    operator: str
    operand: Expr


@dataclass(frozen=True, slots=True)
class Binary(Node):
    """Two operands; ``bare`` tells that no parentheses stand around it."""

    operator: str
    left: Expr
    right: Expr
    parenthesized: bool = False


Expr = Literal | EnumValue | Name | Index | Member | Call | Aggregate | Unary | Binary
