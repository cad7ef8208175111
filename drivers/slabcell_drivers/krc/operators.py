"""What do KRL's operators compute?  Values in, a value out, or the message that the controller would give."""

from collections.abc import Callable

from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.values import (
    BOOL,
    INT,
    REAL,
    CharArray,
    EnumConstant,
    KrlType,
    StructType,
    StructValue,
    Value,
    text_of,
)
from slabcell_drivers.robot.frame import Frame

__all__ = ["BINARY", "UNARY", "binary_type", "frame_of", "geometric", "set_frame"]

FRAME_FIELDS = ("X", "Y", "Z", "A", "B", "C")
_NUMBERS = (int, float)
_32_BITS = 0xFFFFFFFF


def _number(value: Value) -> int | float:
    kind = value.__class__
    if kind is int or kind is float:
        return value
    if kind is str and len(value) == 1:
        return ord(value)
    raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no number")


def _add(a: Value, b: Value) -> Value:
    return _number(a) + _number(b)


def _subtract(a: Value, b: Value) -> Value:
    return _number(a) - _number(b)


def _multiply(a: Value, b: Value) -> Value:
    return _number(a) * _number(b)


def _divide(a: Value, b: Value) -> Value:
    a, b = _number(a), _number(b)
    if b == 0:
        raise KrlError(RunMessage.DIVISION, "division by 0")
    if type(a) is int and type(b) is int:
        quotient = abs(a) // abs(b)
        return quotient if (a < 0) == (b < 0) else -quotient
    return a / b


def _bits(value: Value) -> int:
    if type(value) is int:
        return value
    if type(value) is str and len(value) == 1:
        return ord(value)
    raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no INT")


def _signed(value: int) -> int:
    value &= _32_BITS
    return value - 2**32 if value & 0x80000000 else value


def _comparable(a: Value, b: Value) -> tuple[Value, Value]:
    if isinstance(a, CharArray):
        a = a.text or ""
    if isinstance(b, CharArray):
        b = b.text or ""
    kind_a = a.__class__
    kind_b = b.__class__
    if kind_a is kind_b or (kind_a in _NUMBERS and kind_b in _NUMBERS):
        return a, b
    if kind_a is str and kind_b is int and len(a) == 1:
        return ord(a), b
    if kind_b is str and kind_a is int and len(b) == 1:
        return a, ord(b)
    raise KrlError(RunMessage.TYPE, f"{text_of(a)} and {text_of(b)} cannot be compared")


def _ordered(a: Value, b: Value) -> tuple[Value, Value]:
    a, b = _comparable(a, b)
    if type(a) is bool or isinstance(a, EnumConstant | StructValue):
        raise KrlError(RunMessage.TYPE, f"{text_of(a)} and {text_of(b)} have no order")
    return a, b


def _equal(a: Value, b: Value) -> bool:
    a, b = _comparable(a, b)
    return a == b


def _less(a: Value, b: Value) -> bool:
    a, b = _ordered(a, b)
    return a < b


def _truth(value: Value) -> bool:
    if type(value) is not bool:
        raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no BOOL; a comparison beside it needs parentheses")
    return value


def frame_of(value: Value) -> Frame:
    """Return a FRAME, POS or aggregate as a frame; members never set count as 0.  Raises KrlError for others."""
    if not isinstance(value, StructValue):
        raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no FRAME")
    fields = value.fields
    try:
        return Frame(*(float(fields.get(name) or 0.0) for name in FRAME_FIELDS))
    except (TypeError, ValueError):
        raise KrlError(RunMessage.TYPE, f"{text_of(value)} is no FRAME") from None


def set_frame(target: StructValue, frame: Frame) -> StructValue:
    """Store a frame in the members X to C and return the structure."""
    for name, number in zip(FRAME_FIELDS, frame.as_tuple(), strict=True):
        if target.type is None:
            target.fields[name] = number
        else:
            target.set(name, number)
    return target


def geometric(frame_type: StructType) -> Callable[[Value, Value], Value]:
    """Return the operator ``:``; its result has the type of the right operand, FRAME for an aggregate."""

    def combine(a: Value, b: Value) -> Value:
        product = frame_of(a) @ frame_of(b)
        result = b.copy() if b.type is not None else StructValue(frame_type, {})
        return set_frame(result, product)

    return combine


BINARY: dict[str, Callable[[Value, Value], Value]] = {
    "+": _add,
    "-": _subtract,
    "*": _multiply,
    "/": _divide,
    "==": _equal,
    "<>": lambda a, b: not _equal(a, b),
    "<": _less,
    ">": lambda a, b: _less(b, a),
    "<=": lambda a, b: not _less(b, a),
    ">=": lambda a, b: not _less(a, b),
    "AND": lambda a, b: _truth(a) and _truth(b),
    "OR": lambda a, b: _truth(a) or _truth(b),
    "EXOR": lambda a, b: _truth(a) is not _truth(b),
    "B_AND": lambda a, b: _signed(_bits(a) & _bits(b)),
    "B_OR": lambda a, b: _signed(_bits(a) | _bits(b)),
    "B_EXOR": lambda a, b: _signed(_bits(a) ^ _bits(b)),
}


def _negative(value: Value) -> Value:
    return -_number(value)


UNARY: dict[str, Callable[[Value], Value]] = {
    "+": _number,
    "-": _negative,
    "NOT": lambda a: not _truth(a),
    "B_NOT": lambda a: _signed(~_bits(a)),
}


def binary_type(operator: str, a: KrlType | None, b: KrlType | None) -> KrlType | None:
    """Return the type of a result, None where it is known only when it is computed."""
    if operator in {"==", "<>", "<", ">", "<=", ">=", "AND", "OR", "EXOR"}:
        return BOOL
    if operator.startswith("B_"):
        return INT
    if operator == ":":
        return b
    if a is REAL or b is REAL:
        return REAL
    return INT if a is INT and b is INT else None
