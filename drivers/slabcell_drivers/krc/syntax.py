"""What is a KRL program once it is read?  Statements, routines and files, and all other nodes by this one door."""

from __future__ import annotations

from dataclasses import dataclass

from slabcell_drivers.krc.syntax_declarations import (
    Channel,
    Declaration,
    DeclarationNode,
    Declarator,
    EnumDecl,
    External,
    Import,
    Parameter,
    Signal,
    Struct,
)
from slabcell_drivers.krc.syntax_expressions import (
    Aggregate,
    Binary,
    Call,
    Diagnostic,
    EnumValue,
    Expr,
    Index,
    Literal,
    Member,
    Name,
    Node,
    Place,
    Unary,
)

__all__ = [
    "Aggregate",
    "Analog",
    "Assign",
    "Asynchronous",
    "Binary",
    "Branch",
    "Call",
    "CallStatement",
    "Case",
    "Channel",
    "Confirm",
    "DataList",
    "Declaration",
    "DeclarationNode",
    "Declarator",
    "Diagnostic",
    "EnumDecl",
    "EnumValue",
    "Expr",
    "External",
    "For",
    "Goto",
    "If",
    "Import",
    "Index",
    "Interrupt",
    "InterruptDecl",
    "Keyword",
    "Label",
    "Literal",
    "Loop",
    "Member",
    "Module",
    "Motion",
    "Name",
    "Node",
    "Parameter",
    "Place",
    "Repeat",
    "Return",
    "Routine",
    "Signal",
    "Spline",
    "SplineCondition",
    "Statement",
    "Struct",
    "Switch",
    "Trigger",
    "Unary",
    "Wait",
    "While",
]


@dataclass(frozen=True, slots=True)
class Assign(Node):
    """``target=value``."""

    target: Expr
    value: Expr


@dataclass(frozen=True, slots=True)
class CallStatement(Node):
    """A subprogram called."""

    call: Call


@dataclass(frozen=True, slots=True)
class If(Node):
    """``IF … THEN … ELSE … ENDIF``."""

    condition: Expr
    then: tuple[Statement, ...]
    otherwise: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Case(Node):
    """One ``CASE a,b``; without values it is ``DEFAULT``."""

    values: tuple[Expr, ...]
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Switch(Node):
    """``SWITCH … ENDSWITCH``."""

    subject: Expr
    cases: tuple[Case, ...]


@dataclass(frozen=True, slots=True)
class For(Node):
    """``FOR i=a TO b STEP c``."""

    variable: Expr
    start: Expr
    end: Expr
    step: Expr | None
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class While(Node):
    """``WHILE … ENDWHILE``."""

    condition: Expr
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Repeat(Node):
    """``REPEAT … UNTIL``."""

    body: tuple[Statement, ...]
    condition: Expr


@dataclass(frozen=True, slots=True)
class Loop(Node):
    """``LOOP … ENDLOOP``."""

    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Goto(Node):
    """``GOTO label``."""

    label: str


@dataclass(frozen=True, slots=True)
class Label(Node):
    """``label:``."""

    name: str


@dataclass(frozen=True, slots=True)
class Return(Node):
    """``RETURN`` with or without a value."""

    value: Expr | None


@dataclass(frozen=True, slots=True)
class Keyword(Node):
    """A statement of one word: EXIT, HALT, CONTINUE, RESUME, BRAKE, ``BRAKE F``, ON_ERROR_PROCEED."""

    word: str


@dataclass(frozen=True, slots=True)
class Wait(Node):
    """``WAIT FOR condition`` or ``WAIT SEC seconds``."""

    kind: str
    value: Expr


@dataclass(frozen=True, slots=True)
class Confirm(Node):
    """``CONFIRM message``."""

    value: Expr


@dataclass(frozen=True, slots=True)
class InterruptDecl(Node):
    """``GLOBAL INTERRUPT DECL n WHEN condition DO action``."""

    number: Expr
    condition: Expr
    action: Statement
    is_global: bool = False


@dataclass(frozen=True, slots=True)
class Interrupt(Node):
    """``INTERRUPT ON|OFF|ENABLE|DISABLE [n]``."""

    verb: str
    number: Expr | None


@dataclass(frozen=True, slots=True)
class Trigger(Node):
    """``TRIGGER WHEN DISTANCE|PATH=… [ONSTART] [DELAY=…] DO action [PRIO=…]``."""

    kind: str
    position: Expr
    on_start: bool
    delay: Expr | None
    action: Statement
    priority: Expr | None


@dataclass(frozen=True, slots=True)
class Motion(Node):
    """One motion: PTP, LIN, CIRC, SPTP, SLIN, SCIRC, SPL, with ``_REL`` or not.

    ``points`` holds the target, before it the auxiliary point of a circle; an empty tuple is a point never taught.
    """

    kind: str
    points: tuple[Expr, ...]
    angle: Expr | None = None
    settings: tuple[tuple[Expr, Expr], ...] = ()
    approximation: tuple[str, ...] = ()
    reference: str = ""


@dataclass(frozen=True, slots=True)
class SplineCondition(Node):
    """``TIME_BLOCK``, ``CONST_VEL`` and ``STOP WHEN PATH`` within a spline block."""

    kind: str
    verb: str
    value: Expr | None
    on_start: bool = False
    condition: Expr | None = None


@dataclass(frozen=True, slots=True)
class Spline(Node):
    """``SPLINE|PTP_SPLINE … ENDSPLINE``."""

    kind: str
    settings: tuple[tuple[Expr, Expr], ...]
    body: tuple[Statement, ...]
    approximation: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Analog(Node):
    """``ANIN|ANOUT|DIGIN ON|OFF …``."""

    kind: str
    verb: str
    target: Expr
    value: Expr | None
    options: tuple[tuple[str, Expr], ...]


@dataclass(frozen=True, slots=True)
class Asynchronous(Node):
    """``ASYPTP``, ``ASYSTOP``, ``ASYCONT``, ``ASYCANCEL`` of external axes."""

    verb: str
    value: Expr | None


Branch = If | Switch | For | While | Repeat | Loop | Spline
Statement = (
    Assign
    | CallStatement
    | Branch
    | Goto
    | Label
    | Return
    | Keyword
    | Wait
    | Confirm
    | InterruptDecl
    | Interrupt
    | Trigger
    | Motion
    | SplineCondition
    | Analog
    | Asynchronous
    | DeclarationNode
)


@dataclass(frozen=True, slots=True)
class Routine(Node):
    """``DEF`` or ``DEFFCT``; ``result_type`` is empty for DEF."""

    name: str
    parameters: tuple[Parameter, ...]
    result_type: str
    result_is_array: bool
    body: tuple[Statement, ...]
    is_global: bool
    end: Place


@dataclass(frozen=True, slots=True)
class DataList(Node):
    """``DEFDAT name [PUBLIC] … ENDDAT``."""

    name: str
    is_public: bool
    body: tuple[Statement, ...]


@dataclass(frozen=True, slots=True)
class Module:
    """One file."""

    file: str
    routines: tuple[Routine, ...]
    data: DataList | None
    loose: tuple[Statement, ...]  # outside of every DEF: nothing a controller would take
    diagnostics: tuple[Diagnostic, ...]
