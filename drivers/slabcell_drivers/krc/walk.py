"""Which nodes does a piece of KRL consist of?"""

import dataclasses
from collections.abc import Iterator
from functools import cache
from typing import Any, cast

from slabcell_drivers.krc.syntax import Node

__all__ = ["walk"]


@cache
def _fields(kind: type[Any]) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(kind) if f.name != "place")


def walk(node: object) -> Iterator[Node]:
    """Yield a node and everything below it, in the order of the file."""
    stack: list[object] = [node]
    while stack:
        item = stack.pop()
        if isinstance(item, Node):
            yield item
            stack.extend(getattr(item, name) for name in reversed(_fields(type(item))))
        elif isinstance(item, tuple):
            stack.extend(reversed(cast("tuple[object, ...]", item)))
