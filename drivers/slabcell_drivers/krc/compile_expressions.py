"""How does an expression become a function of an activation?  Names are resolved once, types used where known."""

from collections.abc import Callable, Sequence

from slabcell_drivers.krc.cells import ElementRef, MemberRef, Place, TextRef, Trait
from slabcell_drivers.krc.code import Activation, Code, Function
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.names import ModuleNames, ProjectNames
from slabcell_drivers.krc.operators import BINARY, UNARY, binary_type, geometric
from slabcell_drivers.krc.static_types import Names, type_of
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
from slabcell_drivers.krc.values import (
    BOOL,
    CHAR,
    INT,
    REAL,
    ArrayType,
    ArrayValue,
    CharArray,
    EnumConstant,
    EnumType,
    KrlType,
    StructType,
    StructValue,
    Value,
    real32,
)

__all__ = ["ExpressionCompiler", "Typed", "describe"]

Typed = tuple[Function, KrlType | None]
_RELATIONS = frozenset({"==", "<>", "<", ">", "<=", ">="})
_LOGICAL = frozenset({"AND", "OR", "EXOR"})
_RANK = {"OR": 1, "EXOR": 2, "AND": 3, **dict.fromkeys(_RELATIONS, 4)}


def describe(node: Expr | None) -> str:
    """Return an expression as a message names it."""
    match node:
        case Name(name=name):
            return name
        case Member(base=base, name=name):
            return f"{describe(base)}.{name}"
        case Index(base=base, indices=indices):
            return f"{describe(base)}[{','.join(describe(i) for i in indices)}]"
        case Call(name=name):
            return f"{name}()"
        case Literal(value=value):
            return str(value)
        case EnumValue(name=name):
            return f"#{name}"
        case None:
            return ""
        case _:
            return "expression"


def _raiser(number: int, text: str) -> Function:
    def fail(_: Activation) -> Value:
        raise KrlError(number, text)

    return fail


def _invalid(name: str) -> KrlError:
    return KrlError(RunMessage.VALUE_INVALID, f"{name} value invalid")


class ExpressionCompiler:
    """Compiles the expressions of one routine."""

    def __init__(self, project: ProjectNames, module: ModuleNames | None, code: Code) -> None:
        self.project = project
        self.module = module
        self.code = code
        self.locals: dict[str, int] = {}
        self.local_types: dict[str, KrlType | None] = {}
        self.traits: set[Trait] = set()

    # --- names --------------------------------------------------------------------------------------------------

    def cell(self, name: str) -> Place | None:
        """Return the variable of this name outside of the routine, None if there is none."""
        found = self.project.find(name, self.module)
        if found is not None:
            self.traits |= getattr(found, "traits", frozenset[Trait]())
        return found

    def place(self, node: Expr) -> Callable[[Activation], Place]:
        """Return the function that gives the place which an expression names.  Raises KrlError for others."""
        match node:
            case Name(name=name):
                index = self.locals.get(name)
                if index is not None:
                    return lambda a: a.cells[index]
                cell = self.cell(name)
                if cell is None:
                    raise KrlError(RunMessage.UNDECLARED, f"{name} is not declared")
                return lambda _: cell
            case Member(base=base, name=name):
                parent = self.place(base)
                return lambda a: MemberRef(parent(a), name)
            case Index(base=base, indices=indices):
                return self._element_place(base, indices)
            case _:
                raise KrlError(RunMessage.ARGUMENTS, f"{describe(node)} is no variable")

    def _element_place(self, base: Expr, indices: Sequence[Expr | None]) -> Callable[[Activation], Place]:
        parent = self.place(base)
        given = [self.expr(index)[0] for index in indices if index is not None]
        if not given:  # x[] or x[,]: the whole array
            return parent
        if len(given) < len(indices):  # x[1,]: one row

            def row(a: Activation) -> Place:
                whole = parent(a).value
                element = whole.get(tuple(g(a) for g in given)) if isinstance(whole, ArrayValue) else None
                if not isinstance(element, CharArray):
                    raise KrlError(RunMessage.TYPE, f"{describe(base)} is no array of texts")
                return TextRef(element)

            return row
        if len(given) == 1:
            only = given[0]
            return lambda a: ElementRef(parent(a), (only(a),))
        return lambda a: ElementRef(parent(a), tuple(g(a) for g in given))

    # --- values -------------------------------------------------------------------------------------------------

    def expr(self, node: Expr) -> Typed:
        """Return the function that computes an expression, and the type of its value where it is known."""
        match node:
            case Literal(value=value):
                return self._literal(value)
            case EnumValue(name=name):
                constant = EnumConstant(name)
                return (lambda _: constant), EnumType("", frozenset())
            case Name():
                return self._name(node)
            case Member():
                return self._member(node)
            case Index():
                return self._index(node)
            case Call():
                return self.call(node)
            case Aggregate():
                return self._aggregate(node)
            case Unary(operator=operator, operand=operand):
                function, type_ = self.expr(operand)
                apply = UNARY[operator]
                result = BOOL if operator == "NOT" else type_
                return (lambda a: apply(function(a))), result
            case Binary():
                return self._binary(node)

    def _literal(self, value: int | float | bool | str) -> Typed:  # noqa: FBT001  # a literal is a value
        if isinstance(value, bool):
            return (lambda _: value), BOOL
        if isinstance(value, int):
            if value > 2**31 - 1:  # as 'HFFFFFFFF' the bits of a negative number
                value = value - 2**32 if value < 2**32 else 2**31 - 1
            return (lambda _: value), INT
        if isinstance(value, float):
            rounded = real32(value)
            return (lambda _: rounded), REAL
        return (lambda _: value), CHAR if len(value) == 1 else ArrayType(CHAR, (len(value),))

    def _name(self, node: Name) -> Typed:
        name = node.name
        index = self.locals.get(name)
        if index is not None:

            def load_local(a: Activation) -> Value:
                value = a.cells[index].value
                if value is None:
                    raise _invalid(name)
                return value

            return load_local, self.local_types.get(name)
        cell = self.cell(name)
        if cell is None:
            return _raiser(RunMessage.UNDECLARED, f"{name} is not declared"), None

        def load(_: Activation) -> Value:
            value = cell.value
            if value is None:
                raise _invalid(name)
            return value

        return load, getattr(cell, "type", None)

    def _member(self, node: Member) -> Typed:
        base, base_type = self.expr(node.base)
        name, text = node.name, describe(node)
        type_ = base_type.members.get(name) if isinstance(base_type, StructType) else None

        def load(a: Activation) -> Value:
            structure = base(a)
            if not isinstance(structure, StructValue):
                raise KrlError(RunMessage.TYPE, f"{text}: {describe(node.base)} is no structure")
            value = structure.get(name)
            if value is None:
                raise _invalid(text)
            return value

        return load, type_

    def _index(self, node: Index) -> Typed:
        text = describe(node)
        if any(index is None for index in node.indices):
            return self._whole(node, text)
        place = self.place(node)
        base_type = self._static_type(node.base)
        type_ = base_type.element if isinstance(base_type, ArrayType) else None

        def load(a: Activation) -> Value:
            try:
                value = place(a).value
            except KrlError as error:
                if error.number == RunMessage.INDEX:
                    raise KrlError(error.number, f"{text}: {error.detail}") from None
                raise
            if value is None:
                raise _invalid(text)
            return value

        return load, type_

    def _whole(self, node: Index, text: str) -> Typed:
        place = self.place(node)

        def load(a: Activation) -> Value:
            value = place(a).value
            if isinstance(value, CharArray):
                value = value.text
            if value is None:
                raise _invalid(text)
            return value

        return load, self._static_type(node.base)

    @property
    def names(self) -> Names:
        """What the names of the routine mean, for types that are known before it runs."""
        return Names(self.project, self.module, self.local_types)

    def _static_type(self, node: Expr) -> KrlType | None:
        return type_of(node, self.names)

    def _aggregate(self, node: Aggregate) -> Typed:
        parts: list[tuple[str, Function]] = []
        for position, (name, value) in enumerate(node.members):
            parts.append((name or f"\0{position}", self.expr(value)[0]))
        if not node.type_name:
            return (lambda a: StructValue(None, {name: part(a) for name, part in parts})), None
        type_ = self.project.find_type(node.type_name, self.module)
        if type_ is None:
            return _raiser(RunMessage.UNDECLARED, f"the type {node.type_name} is not declared"), None
        coerce = self.project.coercer(type_)
        return (lambda a: coerce(StructValue(None, {name: part(a) for name, part in parts}))), type_

    def _binary(self, node: Binary) -> Typed:
        if node.operator in _RANK and self._contradicts(node):
            node = _regrouped(node)
        left, left_type = self.expr(node.left)
        right, right_type = self.expr(node.right)
        result_type = binary_type(node.operator, left_type, right_type)
        fast = _fast_arithmetic(node.operator, left, right, left_type, right_type)
        if fast is not None:
            return fast, result_type
        match node.operator:
            case "AND":
                truth = BINARY["AND"]
                return (lambda a: truth(left(a), True) and truth(right(a), True)), BOOL  # noqa: FBT003  # both operands
            case "OR":
                truth = BINARY["AND"]
                return (lambda a: truth(left(a), True) or truth(right(a), True)), BOOL  # noqa: FBT003  # both operands
            case ":":
                frame = self.project.find_type("FRAME", None)
                combine = geometric(frame) if isinstance(frame, StructType) else BINARY["+"]
                return (lambda a: combine(left(a), right(a))), right_type or frame
            case _:
                apply = BINARY[node.operator]
                return (lambda a: apply(left(a), right(a))), result_type

    def _contradicts(self, node: Binary) -> bool:
        """Tell whether an operand of AND, OR or EXOR, grouped as KRL's ranks demand, can be no BOOL.

        ``a==5 AND b==6`` means ``a==(5 AND b)==6`` by the ranks, which no controller can compute; such programs
        exist, so they are read as they are meant, and the static check asks for parentheses.
        """
        match node:
            case Binary(operator=operator, left=left, right=right) if operator in _LOGICAL:
                return any(self._is_no_bool(side) for side in (left, right))
            case Binary(operator=operator, left=left, right=right) if operator in _RELATIONS:
                return any(
                    isinstance(side, Binary) and not side.parenthesized and self._contradicts(side)
                    for side in (left, right)
                )
            case _:
                return False

    def _is_no_bool(self, node: Expr) -> bool:
        if isinstance(node, Binary) and not node.parenthesized and node.operator in _LOGICAL:
            return self._contradicts(node)
        if isinstance(node, Literal):
            return not isinstance(node.value, bool)
        if isinstance(node, EnumValue | Aggregate):
            return True
        if isinstance(node, Binary):
            return node.operator in {"+", "-", "*", "/", ":", "B_AND", "B_OR", "B_EXOR"}
        type_ = self._static_type(node)
        return type_ is not None and type_ is not BOOL

    # --- calls --------------------------------------------------------------------------------------------------

    def call(self, node: Call) -> Typed:
        """Return the call of a function.  Raises KrlError; the routine compiler adds calls of KRL functions."""
        raise KrlError(RunMessage.NOT_SUPPORTED, f"{node.name}() cannot be called here")


def _fast_arithmetic(
    operator: str, left: Function, right: Function, left_type: KrlType | None, right_type: KrlType | None
) -> Function | None:
    """Return an operation that needs no check of its operands' types, None if they are not known to be numbers."""
    numbers = (INT, REAL)
    if left_type not in numbers or right_type not in numbers:
        return None
    match operator:
        case "+":
            return lambda a: left(a) + right(a)
        case "-":
            return lambda a: left(a) - right(a)
        case "*":
            return lambda a: left(a) * right(a)
        case "==":
            return lambda a: left(a) == right(a)
        case "<>":
            return lambda a: left(a) != right(a)
        case "<":
            return lambda a: left(a) < right(a)
        case ">":
            return lambda a: left(a) > right(a)
        case "<=":
            return lambda a: left(a) <= right(a)
        case ">=":
            return lambda a: left(a) >= right(a)
        case _:
            return None


def _regrouped(node: Binary) -> Binary:
    """Return the same operands and operators with comparisons binding more tightly than AND, EXOR and OR."""
    operands: list[Expr] = []
    operators: list[tuple[str, Binary]] = []

    def flatten(part: Expr, *, top: bool = False) -> None:
        if isinstance(part, Binary) and part.operator in _RANK and (top or not part.parenthesized):
            flatten(part.left)
            operators.append((part.operator, part))
            flatten(part.right)
        else:
            operands.append(part)

    flatten(node, top=True)

    def group(start: int, lowest: int) -> tuple[Expr, int]:
        left = operands[start]
        position = start
        while position < len(operators) and _RANK[operators[position][0]] >= lowest:
            operator, origin = operators[position]
            right, after = group(position + 1, _RANK[operator] + 1)
            # in parentheses, so that it is not taken apart again
            left = Binary(origin.place, operator, left, right, parenthesized=True)
            position = after
        return left, position

    result, _ = group(0, 1)
    return result if isinstance(result, Binary) else node
