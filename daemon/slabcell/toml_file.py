"""How is a TOML file that a person wrote turned into checked values, and what is said when it is wrong?

Used by recipes and the cell's configuration.  Unknown keys are errors that name the file, the line, the key and the
nearest known one.
"""

import difflib
import tomllib
import types
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from slabcell.errors import ConfigurationError
from slabcell.toml_lines import KeyPath, key_lines

__all__ = ["TomlDocument", "TomlTable", "check", "parse_document", "read_document", "read_toml"]

MAX_BYTES = 1 << 20


class TomlTable(BaseModel):
    """A table of such a file: immutable, and strict about keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True, slots=True)
class TomlDocument:
    """What a file says, not yet checked, and on which line each of its keys stands."""

    path: Path
    content: dict[str, Any]
    lines: dict[KeyPath, int]

    def place(self, location: KeyPath) -> str:
        """Return file and line of a key, or of the innermost table around it that is written there."""
        for length in range(len(location), 0, -1):
            line = self.lines.get(location[:length])
            if line is not None:
                return f"{self.path}:{line}"
        return str(self.path)


def read_toml(path: Path, model: type[Model], error_type: type[ConfigurationError]) -> Model:
    """Return the checked content of a TOML file.

    Raises ``error_type`` that names the file and, for each thing that is wrong, line, key, value and limit.
    """
    document = read_document(path, error_type)
    return check(document.content, model, error_type, document.place)


def read_document(path: Path, error_type: type[ConfigurationError]) -> TomlDocument:
    """Return what a TOML file says.  Raises ``error_type`` if it cannot be read or is no TOML."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise error_type(msg) from error
    return parse_document(raw, path, error_type)


def parse_document(raw: bytes, path: Path, error_type: type[ConfigurationError]) -> TomlDocument:
    """Return what the bytes of a TOML file say; ``path`` names it in messages.  Raises ``error_type``."""
    if len(raw) > MAX_BYTES:
        msg = f"{path}: is larger than {MAX_BYTES >> 20} MiB; this is no such file"
        raise error_type(msg)
    try:
        text = raw.decode("utf-8")
        return TomlDocument(path, tomllib.loads(text), key_lines(text))
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        msg = f"{path}:{line}: holds a byte that is not UTF-8; save the file as UTF-8"
        raise error_type(msg) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        msg = f"{path}: is not TOML: {error}"
        raise error_type(msg) from error


def check(
    content: Mapping[str, Any],
    model: type[Model],
    error_type: type[ConfigurationError],
    place: Callable[[KeyPath], str],
) -> Model:
    """Return checked values; ``place`` says where a key is written.  Raises ``error_type``, a line for each fault."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        raise error_type("\n".join(_explain(error, model, place))) from error


def _explain(error: ValidationError, model: type[BaseModel], place: Callable[[KeyPath], str]) -> list[str]:
    lines: list[str] = []
    for item in error.errors():
        where = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            known = _keys_at(model, item["loc"][:-1])
            near = difflib.get_close_matches(str(item["loc"][-1]), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(known)}"
            fault = f"unknown key {where!r}: {hint}"
        elif item["type"] == "missing":
            fault = f"key {where!r} is missing"
        elif item["type"] in {"model_type", "model_attributes_type", "dict_type"}:
            fault = f"{where} = {item['input']!r:.60}: is a table with keys of its own, no single value"
        else:
            fault = f"{where} = {item['input']!r:.60}: {item['msg'].removeprefix('Value error, ')}"
        lines.append(f"{place(item['loc'])}: {fault}")
    return lines


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys that the table at this place may have."""
    here = model
    for part in location:
        field = here.model_fields.get(str(part))
        inner = _model_in(field.annotation) if field else None
        here = inner or here
    return list(here.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (typing.Union, types.UnionType, list, tuple):
        return next((found for arg in typing.get_args(annotation) if (found := _model_in(arg))), None)
    return None
