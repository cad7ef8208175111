"""Which values does a KRL program work on?  Types, structures, arrays and texts, and what fits into what.

INT is a Python int, REAL a float rounded to 32 bits, BOOL a bool, CHAR a str of one character and a value of an
enumeration an `EnumConstant`.  None stands for a value that was never set.
"""

import struct
from collections.abc import Callable
from typing import Any

from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.value_types import (
    BOOL,
    CHAR,
    INT,
    POSITION_FIELDS,
    REAL,
    ArrayType,
    EnumConstant,
    EnumType,
    KrlType,
    ScalarType,
    StructType,
)

__all__ = [
    "BOOL",
    "CHAR",
    "INT",
    "POSITION_FIELDS",
    "REAL",
    "ArrayType",
    "ArrayValue",
    "CharArray",
    "EnumConstant",
    "EnumType",
    "KrlType",
    "ScalarType",
    "StructType",
    "StructValue",
    "Value",
    "coercer",
    "copy_value",
    "fresh",
    "real32",
    "text_of",
]

Value = Any
"""A KRL value: int, float, bool, str, EnumConstant, StructValue, ArrayValue, CharArray, or None if never set."""

_F32 = struct.Struct("<f")
_INT_MAX = 2**31 - 1
MAX_ARRAY_ITEMS = 1_000_000


class StructValue:
    """A structure, or an aggregate whose structure is not known yet (``type`` None)."""

    __slots__ = ("fields", "type")

    def __init__(self, type_: StructType | None, fields: dict[str, Value]) -> None:
        self.type = type_
        self.fields = fields

    def copy(self) -> "StructValue":
        """Return a copy that shares nothing."""
        if self.type is not None and self.type.is_flat:
            return StructValue(self.type, self.fields.copy())
        return StructValue(self.type, {name: copy_value(value) for name, value in self.fields.items()})

    def get(self, name: str) -> Value:
        """Return a member, None if it was never set.  Raises KrlError for a member that the structure lacks."""
        value = self.fields.get(name)
        if value is None and self.type is not None:
            member = self.type.members.get(name)
            if member is None:
                raise KrlError(RunMessage.UNDECLARED, f"{self.type.name} has no member {name}")
            if not isinstance(member, ScalarType | EnumType):
                value = self.fields[name] = fresh(member)
        return value

    def set(self, name: str, value: Value) -> None:
        """Set a member, converted to its type.  Raises KrlError if it does not fit."""
        if self.type is None:
            self.fields[name] = value
            return
        member = self.type.members.get(name)
        if member is None:
            raise KrlError(RunMessage.UNDECLARED, f"{self.type.name} has no member {name}")
        self.fields[name] = coercer(member)(value)

    def __eq__(self, other: object) -> bool:
        """Tell whether all members are equal."""
        return isinstance(other, StructValue) and self.fields == other.fields

    __hash__ = None  # pyright: ignore[reportAssignmentType]  # a value that changes is no key

    def __repr__(self) -> str:
        """Return it as KRL writes it."""
        return text_of(self)


class ArrayValue:
    """An array, its items one after the other, the last index running fastest."""

    __slots__ = ("items", "sizes", "type")

    def __init__(self, type_: ArrayType, items: list[Value] | None = None) -> None:
        self.type = type_
        self.sizes = type_.sizes
        count = 1
        for size in type_.sizes:
            count *= size
        if count > MAX_ARRAY_ITEMS:
            raise KrlError(RunMessage.RANGE, f"an array of {count} items is larger than {MAX_ARRAY_ITEMS}")
        self.items: list[Value] = [fresh(type_.element) for _ in range(count)] if items is None else items

    def offset(self, indices: tuple[Value, ...]) -> int:
        """Return where the element lies.  Raises KrlError if an index is outside of its range."""
        if len(indices) != len(self.sizes):
            raise KrlError(RunMessage.INDEX, f"{len(self.sizes)} indices are needed, {len(indices)} given")
        offset = 0
        for index, size in zip(indices, self.sizes, strict=True):
            if type(index) is not int:
                raise KrlError(RunMessage.INDEX, f"the index {text_of(index)} is no INT")
            if not 1 <= index <= size:
                raise KrlError(RunMessage.INDEX, f"index {index} is outside of 1 to {size}")
            offset = offset * size + index - 1
        return offset

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return an element."""
        return self.items[self.offset(indices)]

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Set an element, converted to the type of the array."""
        self.items[self.offset(indices)] = coercer(self.type.element)(value)

    def copy(self) -> "ArrayValue":
        """Return a copy that shares nothing."""
        return ArrayValue(self.type, [copy_value(item) for item in self.items])

    def __eq__(self, other: object) -> bool:
        """Tell whether all items are equal."""
        return isinstance(other, ArrayValue) and self.items == other.items

    __hash__ = None  # pyright: ignore[reportAssignmentType]  # a value that changes is no key


class CharArray:
    """A text of bounded length; ``text`` is None until something was stored."""

    __slots__ = ("size", "text")

    def __init__(self, size: int, text: str | None = None) -> None:
        self.size = size
        self.text = text

    def get(self, indices: tuple[Value, ...]) -> Value:
        """Return one character, None behind the end of the text."""
        (index,) = self._checked(indices)
        text = self.text or ""
        return text[index - 1] if index <= len(text) else None

    def set(self, indices: tuple[Value, ...], value: Value) -> None:
        """Set one character; what lies between the end of the text and it is filled with blanks."""
        (index,) = self._checked(indices)
        text = (self.text or "").ljust(index - 1)
        self.text = text[: index - 1] + _to_char(value) + text[index:]

    def _checked(self, indices: tuple[Value, ...]) -> tuple[int]:
        if len(indices) != 1 or type(indices[0]) is not int:
            raise KrlError(RunMessage.INDEX, "one INT is needed as index of a CHAR array")
        if not 1 <= indices[0] <= self.size:
            raise KrlError(RunMessage.INDEX, f"index {indices[0]} is outside of 1 to {self.size}")
        return indices

    def assign(self, value: Value) -> None:
        """Store a text; one too long is an error."""
        text = value.text if isinstance(value, CharArray) else value
        if not isinstance(text, str):
            raise KrlError(RunMessage.ASSIGNMENT, f"{text_of(value)} is no text")
        if len(text) > self.size:
            raise KrlError(RunMessage.ASSIGNMENT, f'the text "{text}" is longer than the CHAR array of {self.size}')
        self.text = text

    def copy(self) -> "CharArray":
        """Return a copy."""
        return CharArray(self.size, self.text)

    def __eq__(self, other: object) -> bool:
        """Tell whether the texts are equal."""
        return (self.text or "") == ((other.text or "") if isinstance(other, CharArray) else other)

    __hash__ = None  # pyright: ignore[reportAssignmentType]  # a value that changes is no key


def real32(value: float) -> float:
    """Return the nearest REAL.  Raises KrlError if it is too large for one."""
    try:
        return _F32.unpack(_F32.pack(value))[0]
    except OverflowError:
        raise KrlError(RunMessage.OVERFLOW, f"{value:g} is too large for a REAL") from None


def fresh(type_: KrlType) -> Value:
    """Return what a variable of this type holds before anything was stored."""
    if isinstance(type_, ScalarType | EnumType):
        return None
    if isinstance(type_, StructType):
        return StructValue(type_, {})
    if type_.element is CHAR:
        if len(type_.sizes) == 1:
            return CharArray(type_.sizes[0])
        rows = ArrayType(ArrayType(CHAR, type_.sizes[-1:]), type_.sizes[:-1])
        return ArrayValue(rows)
    return ArrayValue(type_)


def copy_value(value: Value) -> Value:
    """Return a value that shares nothing with this one."""
    return value.copy() if isinstance(value, StructValue | ArrayValue | CharArray) else value


def _mismatch(value: Value, type_: KrlType) -> KrlError:
    return KrlError(RunMessage.ASSIGNMENT, f"{text_of(value)} does not fit into {type_.name}")


def _to_int(value: Value) -> int:
    kind = value.__class__
    if kind is float:
        value = int(value + 0.5) if value >= 0 else -int(0.5 - value)
    elif kind is str and len(value) == 1:
        return ord(value)
    elif kind is not int:
        raise _mismatch(value, INT)
    if not -_INT_MAX - 1 <= value <= _INT_MAX:
        raise KrlError(RunMessage.OVERFLOW, f"{value} is too large for an INT")
    return value


def _to_real(value: Value) -> float:
    kind = value.__class__
    if kind is float or kind is int:
        return real32(value)
    if kind is str and len(value) == 1:
        return float(ord(value))
    raise _mismatch(value, REAL)


def _to_bool(value: Value) -> bool:
    if type(value) is bool:
        return value
    raise _mismatch(value, BOOL)


def _to_char(value: Value) -> str:
    if type(value) is str and len(value) == 1:
        return value
    if type(value) is int and 0 <= value <= 255:
        return chr(value)
    if isinstance(value, CharArray) and value.text and len(value.text) == 1:
        return value.text
    raise _mismatch(value, CHAR)


_SCALARS: dict[str, Callable[[Value], Value]] = {"INT": _to_int, "REAL": _to_real, "BOOL": _to_bool, "CHAR": _to_char}


def coercer(type_: KrlType) -> Callable[[Value], Value]:
    """Return the function that makes a value of this type out of another, or raises KrlError."""
    if isinstance(type_, ScalarType):
        return _SCALARS[type_.name]
    if isinstance(type_, EnumType):
        return _enum_coercer(type_)
    if isinstance(type_, StructType):
        return _struct_coercer(type_)
    return _array_coercer(type_)


def _enum_coercer(type_: EnumType) -> Callable[[Value], Value]:
    def to_enum(value: Value) -> EnumConstant:
        if isinstance(value, EnumConstant) and (not type_.values or value.name in type_.values):
            return value
        raise _mismatch(value, type_)

    return to_enum


def _struct_coercer(type_: StructType) -> Callable[[Value], Value]:
    is_position = type_.name in POSITION_FIELDS

    def to_struct(value: Value) -> StructValue:
        if not isinstance(value, StructValue):
            raise _mismatch(value, type_)
        if value.type is type_:
            return value.copy()
        if value.type is not None:
            source = POSITION_FIELDS.get(value.type.name)
            if is_position and source is not None and ("X" in source) == ("X" in type_.members):
                fields = {n: v for n, v in value.fields.items() if n in type_.members and v is not None}
                return StructValue(type_, fields)
            if value.type.name != type_.name:
                raise _mismatch(value, type_)
        return _struct_of_aggregate(type_, value)

    return to_struct


def _struct_of_aggregate(type_: StructType, value: StructValue) -> StructValue:
    result = StructValue(type_, {})
    names = list(type_.members)
    for name, item in value.fields.items():
        if name.startswith("\0"):  # positional
            position = int(name[1:])
            if position >= len(names):
                raise KrlError(RunMessage.ARGUMENTS, f"{type_.name} has {len(names)} members, not {position + 1}")
            result.set(names[position], item)
        elif name.endswith("]"):
            base, _, index = name[:-1].partition("[")
            array = result.get(base)
            if not isinstance(array, ArrayValue | CharArray):
                raise KrlError(RunMessage.TYPE, f"{type_.name}.{base} is no array")
            array.set(tuple(int(part) for part in index.split(",")), item)
        elif item is not None:
            result.set(name, item)
    return result


def _array_coercer(type_: ArrayType) -> Callable[[Value], Value]:
    is_text = type_.element is CHAR and len(type_.sizes) == 1

    def to_array(value: Value) -> Value:
        if is_text:
            text = CharArray(type_.sizes[0] or (value.size if isinstance(value, CharArray) else 80))
            text.assign(value)
            return text
        if isinstance(value, ArrayValue):
            return value.copy()
        if isinstance(value, StructValue) and value.type is None:
            result = ArrayValue(type_)
            for position, item in enumerate(value.fields.values()):
                result.set((position + 1,), item)
            return result
        raise _mismatch(value, type_)

    return to_array


def _member_name(name: str, item: Value) -> str:
    if name.startswith("\0"):
        return ""
    return f"{name}[]" if isinstance(item, CharArray) else name


def text_of(value: Value) -> str:
    """Return a value as KRL writes it."""
    if value is None:
        return "?"
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, float):
        text = f"{value:.7g}"
        return text if any(c in text for c in ".einf") else text + ".0"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, CharArray):
        return f'"{value.text or ""}"'
    if isinstance(value, StructValue):
        parts = [
            f"{_member_name(name, item)} {text_of(item)}".strip()
            for name, item in value.fields.items()
            if item is not None and not (isinstance(item, CharArray) and item.text is None)
        ]
        return "{" + ",".join(parts) + "}"
    if isinstance(value, ArrayValue):
        return "{" + ",".join(text_of(item) for item in value.items) + "}"
    return str(value)
