"""Where does each value of the configuration come from?  ``cell.toml``, its drop-ins in order, then the environment.

For ``/etc/slabcell/cell.toml`` the drop-ins are ``/etc/slabcell/cell.toml.d/*.toml``, in the order of their names.  A
variable ``SLABCELL__CAMERA__TIMEOUT_S=5`` sets the key ``timeout_s`` of ``[camera]``; its value is written as in TOML,
or is a plain text.  Later layers win key by key; a list is replaced as a whole.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

from slabcell.errors import ConfigurationError
from slabcell.service.config import CellConfig
from slabcell.toml_file import check, read_document
from slabcell.toml_lines import KeyPath

__all__ = ["LoadedConfig", "Value", "leaves", "load_config", "load_layers"]

PREFIX: Final = "SLABCELL__"
MAX_DROP_INS: Final = 100

Content = dict[str, Any]
Place = Callable[[KeyPath], str]


@dataclass(frozen=True, slots=True)
class Value:
    """One key, dotted, its value, and where that was written; ``default`` if nowhere."""

    key: str
    value: object
    origin: str


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """The checked configuration and where its values come from.  ``files`` are those that were read, in order."""

    config: CellConfig
    values: tuple[Value, ...]
    files: tuple[Path, ...]


def load_config(path: Path) -> CellConfig:
    """Return the checked configuration; files named in it are relative to ``path``.  Raises ConfigurationError."""
    return load_layers(path).config


def load_layers(path: Path, environment: Mapping[str, str] | None = None) -> LoadedConfig:
    """Return the configuration with the origin of each value.  Raises ConfigurationError, a line for each fault."""
    environment = os.environ if environment is None else environment
    files = (path, *_drop_ins(path))
    merged: Content = {}
    origins: dict[KeyPath, str] = {}
    for file in files:
        document = read_document(file, ConfigurationError)
        _merge(merged, document.content, origins, (), document.place)
    for name in sorted(environment):
        if name.startswith(PREFIX):
            keys = tuple(part.lower() for part in name.removeprefix(PREFIX).split("__"))
            _merge(merged, _nested(keys, _value(environment[name])), origins, (), lambda _, name=name: f"${name}")

    def place(location: KeyPath) -> str:
        for length in range(len(location), 0, -1):
            if location[:length] in origins:
                return origins[location[:length]]
        return str(path)

    config = _located(check(merged, CellConfig, ConfigurationError, place), path.parent)
    values = tuple(
        Value(".".join(keys), value, _origin(keys, origins)) for keys, value in leaves(config.model_dump(mode="json"))
    )
    return LoadedConfig(config, values, files)


def leaves(content: Mapping[str, Any], above: tuple[str, ...] = ()) -> list[tuple[tuple[str, ...], object]]:
    """Return every key that is no table, with its path and its value."""
    found: list[tuple[tuple[str, ...], object]] = []
    for name, value in content.items():
        if isinstance(value, Mapping):
            found += leaves(cast("Mapping[str, Any]", value), (*above, name))
        else:
            found.append(((*above, name), value))
    return found


def _drop_ins(path: Path) -> list[Path]:
    folder = path.with_name(f"{path.name}.d")
    try:
        found = sorted(file for file in folder.iterdir() if file.suffix == ".toml")
    except (FileNotFoundError, NotADirectoryError):
        return []
    except OSError as error:
        msg = f"{folder}: cannot be read: {error.strerror}"
        raise ConfigurationError(msg) from error
    if len(found) > MAX_DROP_INS:
        msg = f"{folder}: holds {len(found)} files; at most {MAX_DROP_INS} are read"
        raise ConfigurationError(msg)
    return found


def _merge(into: Content, content: Content, origins: dict[KeyPath, str], above: KeyPath, place: Place) -> None:
    for name, value in content.items():
        path = (*above, name)
        if isinstance(value, dict):
            inner = into.get(name)
            if not isinstance(inner, dict):
                inner = into[name] = {}
            origins.setdefault(path, place(path))
            _merge(cast("Content", inner), cast("Content", value), origins, path, place)
        else:
            into[name] = value
            for stale in [known for known in origins if known[: len(path)] == path]:
                del origins[stale]
            origins[path] = place(path)


def _nested(keys: tuple[str, ...], value: object) -> Content:
    for key in reversed(keys):
        value = {key: value}
    return cast("Content", value)


def _value(text: str) -> object:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _origin(keys: tuple[str, ...], origins: dict[KeyPath, str]) -> str:
    """Return where a value was written; a list counts by its own key."""
    return origins.get(keys, "default")


def _located(config: CellConfig, here: Path) -> CellConfig:
    """Return the configuration with every file and folder that it names relative to its own place."""
    return CellConfig.model_validate(_beside(config.model_dump(), here))


def _beside(value: Any, here: Path) -> Any:
    """Return a value of a configuration with the paths in it, at any depth, taken as seen from ``here``."""
    match value:
        case Path():
            return here / value
        case dict():
            return {key: _beside(inner, here) for key, inner in cast("Content", value).items()}
        case list():
            return [_beside(inner, here) for inner in cast("list[Any]", value)]
        case _:
            return value
