"""How is a TOML file that a person wrote turned into checked values, and what is said when it is wrong?

Used by recipes and the cell's configuration.  Unknown keys are errors that name the file, the key and the nearest
known one.
"""

import difflib
import tomllib
import types
import typing
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from slabcell.errors import ConfigurationError

__all__ = ["TomlTable", "read_toml"]

MAX_BYTES = 1 << 20


class TomlTable(BaseModel):
    """A table of such a file: immutable, and strict about keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: Path, model: type[Model], error_type: type[ConfigurationError]) -> Model:
    """Return the checked content of a TOML file.

    Raises ``error_type`` that names the file and, for each thing that is wrong, key, value and limit.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise error_type(msg) from error
    if len(raw) > MAX_BYTES:
        msg = f"{path}: is larger than {MAX_BYTES >> 20} MiB; this is no such file"
        raise error_type(msg)
    try:
        return model.model_validate(tomllib.loads(raw.decode("utf-8")))
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        msg = f"{path}:{line}: holds a byte that is not UTF-8; save the file as UTF-8"
        raise error_type(msg) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        msg = f"{path}: is not TOML: {error}"
        raise error_type(msg) from error
    except ValidationError as error:
        raise error_type("\n".join(f"{path}: {line}" for line in _explain(error, model))) from error


def _explain(error: ValidationError, model: type[BaseModel]) -> list[str]:
    lines: list[str] = []
    for item in error.errors():
        where = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            known = _keys_at(model, item["loc"][:-1])
            near = difflib.get_close_matches(str(item["loc"][-1]), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known here: {', '.join(known)}"
            lines.append(f"unknown key {where!r}: {hint}")
        elif item["type"] == "missing":
            lines.append(f"key {where!r} is missing")
        elif item["type"] == "value_error":  # of a whole table: the message names the keys
            text = item["msg"].removeprefix("Value error, ")
            lines.append(f"[{where}]: {text}" if where else text)
        else:
            text = item["msg"].replace(" after validation", "")
            lines.append(f"{where} = {item['input']!r:.60}: {text}")
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
