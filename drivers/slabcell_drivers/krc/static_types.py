"""Of which type is an expression, as far as it can be told before the program runs?"""

from collections.abc import Mapping

from slabcell_drivers.krc.names import ModuleNames, ProjectNames
from slabcell_drivers.krc.syntax import (
    Aggregate,
    Binary,
    Call,
    EnumValue,
    Expr,
    Index,
    Literal,
    Member,
    Name,
    Unary,
)
from slabcell_drivers.krc.values import BOOL, CHAR, INT, REAL, ArrayType, EnumType, KrlType, StructType

__all__ = ["ANY_ENUM", "Names", "fits", "is_text", "type_of"]

ANY_ENUM = EnumType("", frozenset())
_RELATIONS = frozenset({"==", "<>", "<", ">", "<=", ">="})


class Names:
    """What the names of a routine mean."""

    def __init__(self, project: ProjectNames, module: ModuleNames | None, local: Mapping[str, KrlType | None]) -> None:
        self.project = project
        self.module = module
        self.local = local

    def type_of_name(self, name: str) -> KrlType | None:
        """Return the type of a variable, None if it is not known."""
        if name in self.local:
            return self.local[name]
        return getattr(self.project.find(name, self.module), "type", None)


def type_of(node: Expr, names: Names) -> KrlType | None:
    """Return the type of an expression, None where it cannot be told."""
    match node:
        case Literal(value=bool()):
            return BOOL
        case Literal(value=int()):
            return INT
        case Literal(value=float()):
            return REAL
        case Literal(value=value):
            return CHAR if len(str(value)) == 1 else ArrayType(CHAR, (len(str(value)),))
        case EnumValue():
            return ANY_ENUM
        case Name(name=name):
            return names.type_of_name(name)
        case Member(base=base, name=name):
            type_ = type_of(base, names)
            return type_.members.get(name) if isinstance(type_, StructType) else None
        case Index(base=base, indices=indices):
            type_ = type_of(base, names)
            if not isinstance(type_, ArrayType):
                return None
            if all(index is None for index in indices):
                return type_
            if isinstance(type_.element, ArrayType) and len(indices) > len(type_.sizes) and indices[-1] is not None:
                return type_.element.element
            return type_.element
        case Aggregate(type_name=type_name):
            return names.project.find_type(type_name, names.module) if type_name else None
        case Unary(operator=operator, operand=operand):
            return BOOL if operator == "NOT" else type_of(operand, names)
        case Call(name=name):
            return _type_of_call(name, names)
        case Binary(operator=operator, left=left, right=right):
            return _type_of_binary(operator, left, right, names)


def _type_of_call(name: str, names: Names) -> KrlType | None:
    found = names.project.routine(name, names.module)
    if found is not None:
        routine, module = found
        if routine.result_is_array or not routine.result_type:
            return None
        return names.project.find_type(routine.result_type, module)
    builtin = names.project.builtins.get(name)
    return names.project.find_type(builtin.result, None) if builtin is not None and builtin.result else None


def _type_of_binary(operator: str, left: Expr, right: Expr, names: Names) -> KrlType | None:
    if operator in _RELATIONS or operator in {"AND", "OR", "EXOR"}:
        return BOOL
    if operator.startswith("B_"):
        return INT
    if operator == ":":
        return type_of(right, names)
    a, b = type_of(left, names), type_of(right, names)
    if a is REAL or b is REAL:
        return REAL
    return INT if a is INT and b is INT else None


def is_text(type_: KrlType | None) -> bool:
    """Tell whether a type is a CHAR array."""
    return isinstance(type_, ArrayType) and type_.element is CHAR


def fits(value: KrlType | None, target: KrlType | None) -> bool:
    """Tell whether a value of one type can be stored in a variable of another; unknown types fit everything."""
    if value is None or target is None or value is target:
        return True
    numbers = (INT, REAL, CHAR)
    if value in numbers and target in numbers:
        return True
    if isinstance(value, EnumType) and isinstance(target, EnumType):
        return True
    if isinstance(target, ArrayType):
        return isinstance(value, ArrayType) or (is_text(target) and value is CHAR)
    if isinstance(value, StructType) and isinstance(target, StructType):
        return value.name == target.name or ("X" in value.members) == ("X" in target.members)
    return False
