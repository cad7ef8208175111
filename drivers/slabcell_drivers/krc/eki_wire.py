"""How does a channel's XML look on the wire?  Values to the telegrams that EKI sends, and telegrams to received values.

Written as public recordings of controllers show it: no declaration, no line end, explicit end tags, a part of the tree
wrapped in its ancestors.  The order of attributes is not documented, so it can be shuffled.
"""

import math
import random
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from xml.sax.saxutils import escape, quoteattr

from slabcell_drivers.krc.eki_config import FRAME_KEYS, ElementType
from slabcell_drivers.krc.eki_memory import Value
from slabcell_drivers.krc.eki_xml import XmlElement
from slabcell_drivers.robot.frame import Frame

__all__ = ["ReceivedElement", "read_value", "received_elements", "send_paths", "single_precision", "write_branch"]

MAX_STRING_CHARS = 3600
MAX_INT, MIN_INT = 2**31 - 1, -(2**31)


# ------------------------------------------------------------------------------------------------------------- writing


@dataclass(slots=True)
class _Node:
    name: str
    attributes: dict[str, str] = field(default_factory=dict[str, str])
    children: dict[str, "_Node"] = field(default_factory=dict[str, "_Node"])
    text: str = ""
    only_attributes_configured: bool = True

    @property
    def empty(self) -> bool:
        return self.only_attributes_configured and not (self.attributes or self.text or self.children)


def send_paths(tags: tuple[str, ...], path: str) -> bool:
    """Tell whether the path is configured to be sent: an element, or a node above one."""
    return any(tag == path or tag.startswith(f"{path}/") for tag in tags)


def write_branch(
    tags: tuple[str, ...], path: str, values: Mapping[str, Value], *, shuffle: random.Random | None = None
) -> bytes:
    """Return the telegram for a configured path: the branch below it, wrapped in its ancestors.

    Elements come in the order of the configuration, attributes too unless ``shuffle`` is given.
    """
    root: _Node | None = None
    for tag in tags:
        if not (tag == path or tag.startswith(f"{path}/")):
            continue
        parts = tag.split("/")
        if root is None:
            root = _Node(parts[0])
        _add(root, parts[1:], values.get(tag))
    if root is None:
        msg = f"{path!r} is not configured to be sent"
        raise ValueError(msg)
    return _render(root, shuffle, keep=True).encode("utf-8")


def _add(root: _Node, parts: list[str], value: Value | None) -> None:
    node = root
    for part in parts:
        if part.startswith("@"):
            if value is not None:
                node.attributes[part[1:]] = _text(value)
            return
        node = node.children.setdefault(part, _Node(part))
    node.only_attributes_configured = False
    if isinstance(value, Frame):
        node.attributes.update({key: _text(float(v)) for key, v in zip(FRAME_KEYS, value.as_tuple(), strict=True)})
    elif value is not None:
        node.text = _text(value)


def _render(node: _Node, shuffle: random.Random | None, *, keep: bool) -> str:
    children = "".join(_render(child, shuffle, keep=False) for child in node.children.values())
    if not keep and node.empty:
        return ""
    names = list(node.attributes)
    if shuffle is not None:
        shuffle.shuffle(names)
    attributes = "".join(f" {name}={quoteattr(node.attributes[name])}" for name in names)
    return f"<{node.name}{attributes}>{escape(node.text)}{children}</{node.name}>"


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return "1" if value else "0"
    if isinstance(value, float):
        return f"{value:.6f}"
    return str(value)


# ------------------------------------------------------------------------------------------------------------- reading


@dataclass(frozen=True, slots=True)
class ReceivedElement:
    """One element or attribute of a received telegram, by the path that a configuration would name it with."""

    path: str
    text: str
    attributes: Mapping[str, str]


def received_elements(root: XmlElement) -> Iterator[ReceivedElement]:
    """Yield attributes and elements in the order in which they are complete: the root comes last."""
    stack: list[tuple[XmlElement, str, Iterator[XmlElement]]] = [(root, root.name, iter(root.children))]
    yield from _attributes(root, root.name)
    while stack:
        element, path, children = stack[-1]
        child = next(children, None)
        if child is None:
            stack.pop()
            yield ReceivedElement(path, element.text, element.attributes)
        else:
            child_path = f"{path}/{child.name}"
            stack.append((child, child_path, iter(child.children)))
            yield from _attributes(child, child_path)


def _attributes(element: XmlElement, path: str) -> Iterator[ReceivedElement]:
    for name, text in element.attributes.items():
        yield ReceivedElement(f"{path}/@{name}", text, {})


def read_value(element: ReceivedElement, kind: ElementType) -> Value:
    """Return the value of a received element.  Raises ValueError if it does not read as its type."""
    text = element.text.strip()
    match kind:
        case ElementType.BOOL:
            if text.lower() in {"1", "true"}:
                return True
            if text.lower() in {"0", "false"}:
                return False
            msg = f"{element.path}: {text[:40]!r} is not a BOOL"
            raise ValueError(msg)
        case ElementType.INT:
            return _read_int(element.path, text)
        case ElementType.REAL:
            return _read_real(element.path, text)
        case ElementType.FRAME:
            x, y, z, a, b, c = (
                _read_real(f"{element.path}/@{key}", element.attributes.get(key, "0")) for key in FRAME_KEYS
            )
            return Frame(x, y, z, a, b, c)
        case _:
            if len(element.text) > MAX_STRING_CHARS:
                msg = f"{element.path}: {len(element.text)} characters, at most {MAX_STRING_CHARS} are taken"
                raise ValueError(msg)
            return element.text


def _read_int(path: str, text: str) -> int:
    digits = text.removeprefix("-").removeprefix("+")
    value = int(text) if digits.isascii() and digits.isdigit() and len(digits) <= 10 else None
    if value is None or not MIN_INT <= value <= MAX_INT:
        msg = f"{path}: {text[:40]!r} is not an INT of 32 bits"
        raise ValueError(msg)
    return value


def _read_real(path: str, text: str) -> float:
    try:
        value = single_precision(float(text)) if len(text) <= 40 and "_" not in text else math.nan
    except (ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        msg = f"{path}: {text[:40]!r} is not a REAL"
        raise ValueError(msg)
    return value


def single_precision(value: float) -> float:
    """Return the value as KRL's REAL holds it: 32 bits.  Raises OverflowError beyond its range."""
    (rounded,) = struct.unpack("f", struct.pack("f", value))
    return float(rounded)
