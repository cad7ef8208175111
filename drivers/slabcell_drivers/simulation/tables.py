"""How does a TOML table become a checked value?  Unknown keys, missing keys and wrong types are errors that say where.

A table is read into a frozen dataclass by the annotations of its fields.  Known annotations are float, int, str, bool,
tuple[float, ...], lists of points (`Outline`), and other dataclasses.
"""

import dataclasses
import difflib
import math
import tomllib
import typing
from collections.abc import Mapping
from enum import EnumType, StrEnum
from pathlib import Path
from typing import TypeVar

__all__ = ["Outline", "SceneError", "read_document", "read_table"]

MAX_BYTES = 1 << 20
MAX_POINTS = 10_000

Value = TypeVar("Value")

Outline = tuple[tuple[float, float], ...]
"""Corners of a polygon in mm, in order, the first not repeated."""


class SceneError(ValueError):
    """A scene file is wrong; the message names file, key, value and remedy."""


def read_document(path: Path) -> dict[str, object]:
    """Return the tables of a TOML file.  Raises SceneError if it cannot be read or is not TOML."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise SceneError(msg) from error
    if len(raw) > MAX_BYTES:
        msg = f"{path}: is larger than {MAX_BYTES} bytes, which no scene is"
        raise SceneError(msg)
    try:
        return tomllib.loads(raw.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        msg = f"{path}: is not TOML in UTF-8: {error}"
        raise SceneError(msg) from error


def read_table(kind: type[Value], table: object, where: str) -> Value:
    """Return a table as a value of ``kind``, a dataclass.  Raises SceneError."""
    if not isinstance(table, Mapping):
        msg = f"{where}: must be a table, not {table!r}"
        raise SceneError(msg)
    content = typing.cast("Mapping[str, object]", table)
    fields = {field.name: field for field in dataclasses.fields(typing.cast("typing.Any", kind)) if field.init}
    for key in content:
        if key not in fields:
            near = difflib.get_close_matches(key, list(fields), n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(fields)}"
            msg = f"{where}: unknown key {key!r}: {hint}"
            raise SceneError(msg)
    hints = typing.get_type_hints(kind)
    arguments: dict[str, object] = {}
    for name, field in fields.items():
        if name in content:
            arguments[name] = _read_value(hints[name], content[name], f"{where}.{name}")
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            msg = f"{where}: key {name!r} is missing"
            raise SceneError(msg)
    try:
        return kind(**arguments)
    except SceneError:
        raise
    except ValueError as error:
        msg = f"{where}: {error}"
        raise SceneError(msg) from error


def _read_value(annotation: object, value: object, where: str) -> object:
    if annotation == Outline:
        return _read_outline(value, where)
    if dataclasses.is_dataclass(annotation):
        return read_table(typing.cast("type[object]", annotation), value, where)
    if typing.get_origin(annotation) is tuple:
        if not isinstance(value, list):
            msg = f"{where} = {value!r}: must be a list of numbers"
            raise SceneError(msg)
        items = typing.cast("list[object]", value)
        return tuple(_read_number(item, f"{where}[{index}]") for index, item in enumerate(items))
    if isinstance(annotation, EnumType):
        choices = [str(choice) for choice in typing.cast("type[StrEnum]", annotation)]
        if value in choices:
            return typing.cast("type[StrEnum]", annotation)(value)
        msg = f"{where} = {value!r}: must be one of {', '.join(choices)}"
        raise SceneError(msg)
    if annotation is float:
        return _read_number(value, where)
    if any(annotation is plain and type(value) is plain for plain in (int, str, bool)):
        return value
    msg = f"{where} = {value!r}: must be {getattr(annotation, '__name__', annotation)}"
    raise SceneError(msg)


def _read_number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        msg = f"{where} = {value!r}: must be a finite number"
        raise SceneError(msg)
    return float(value)


def _read_outline(value: object, where: str) -> Outline:
    if not isinstance(value, list) or not 3 <= len(typing.cast("list[object]", value)) <= MAX_POINTS:
        msg = f"{where}: must be a list of at least three points [x, y]"
        raise SceneError(msg)
    points: list[tuple[float, float]] = []
    for index, item in enumerate(typing.cast("list[object]", value)):
        pair = typing.cast("list[object]", item) if isinstance(item, list) else []
        if len(pair) != 2:
            msg = f"{where}[{index}] = {item!r}: must be a point [x, y]"
            raise SceneError(msg)
        points.append((_read_number(pair[0], f"{where}[{index}].x"), _read_number(pair[1], f"{where}[{index}].y")))
    return tuple(points)
