"""What stands in KRL declarations?"""

from __future__ import annotations

from dataclasses import dataclass

from slabcell_drivers.krc.syntax_expressions import Expr, Node

__all__ = [
    "Channel",
    "Declaration",
    "DeclarationNode",
    "Declarator",
    "EnumDecl",
    "External",
    "Import",
    "Parameter",
    "Signal",
    "Struct",
]


@dataclass(frozen=True, slots=True)
class Declarator(Node):
    """One name of a declaration; a dimension left empty is None."""

    name: str
    dimensions: tuple[Expr | None, ...] = ()
    value: Expr | None = None


@dataclass(frozen=True, slots=True)
class Declaration(Node):
    """``DECL GLOBAL CONST type a,b[3]=…``."""

    type_name: str
    names: tuple[Declarator, ...]
    is_global: bool = False
    is_const: bool = False


@dataclass(frozen=True, slots=True)
class Struct(Node):
    """``STRUC name type a,b,type c``."""

    name: str
    members: tuple[tuple[str, Declarator], ...]
    is_global: bool = False


@dataclass(frozen=True, slots=True)
class EnumDecl(Node):
    """``ENUM name a,b``."""

    name: str
    values: tuple[str, ...]
    is_global: bool = False


@dataclass(frozen=True, slots=True)
class Signal(Node):
    """``SIGNAL name $IN[1] TO $IN[8]``; without first it is switched off (``FALSE``)."""

    name: str
    first: Expr | None
    last: Expr | None = None
    is_global: bool = False


@dataclass(frozen=True, slots=True)
class Channel(Node):
    """``CHANNEL :name :interface structure``."""

    name: str
    interface: str
    structure: Expr | None = None


@dataclass(frozen=True, slots=True)
class Import(Node):
    """``IMPORT type name IS /R1/module..name``."""

    type_name: str
    name: str
    module: str
    source: str


@dataclass(frozen=True, slots=True)
class Parameter(Node):
    """One formal parameter: mode ``IN``, ``OUT`` or empty where none is written."""

    name: str
    dimensions: int = 0
    mode: str = ""
    type_name: str = ""


@dataclass(frozen=True, slots=True)
class External(Node):
    """``EXT name(…)``, ``EXTFCT type name(…)``, ``EXTP``, ``EXTFCTP``."""

    name: str
    result_type: str
    parameters: tuple[Parameter, ...]


DeclarationNode = Declaration | Struct | EnumDecl | Signal | Channel | Import | External
