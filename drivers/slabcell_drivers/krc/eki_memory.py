"""What has a channel received and not yet read?  One bounded memory for each configured element.

Memories know nothing of telegrams: an element that is left out of one telegram shifts against its neighbours, as on the
controller.  The number of the telegram is kept with each value, for the counter in EKI_STATUS.
"""

from collections import deque
from dataclasses import dataclass

from slabcell_drivers.krc.eki_config import FRAME_KEYS, Buffering, ElementType, ReceiveElement
from slabcell_drivers.robot.frame import Frame

__all__ = ["ElementMemories", "Entry", "Value"]

Value = bool | int | float | str | Frame


@dataclass(frozen=True, slots=True)
class Entry:
    """One received value and the number of the telegram that brought it."""

    value: Value
    telegram: int


class ElementMemories:
    """The memories of one channel, by tag."""

    def __init__(self, elements: tuple[ReceiveElement, ...], limit: int) -> None:
        self._limit = limit
        self._elements = {element.tag: element for element in elements}
        self._memories: dict[str, deque[Entry]] = {
            element.tag: deque() for element in elements if element.type is not None
        }

    def store(self, tag: str, entry: Entry) -> bool:
        """Keep a value; return False if that is one more than the limit.  Beyond limit + 1 nothing is kept."""
        memory = self._memories[tag]
        if len(memory) <= self._limit:
            memory.append(entry)
        return len(memory) <= self._limit

    def tags_of(self, path: str, kind: ElementType) -> tuple[str, ...] | None:
        """Return the tags whose memories hold a value of this kind: one, or the six of a frame; None if unknown."""
        if path in self._memories:
            return (path,)
        six = tuple(f"{path}/@{key}" for key in FRAME_KEYS)
        if kind is ElementType.FRAME and all(tag in self._memories for tag in six):
            return six
        return None

    def type_of(self, tag: str) -> ElementType | None:
        """Return the configured type."""
        return self._elements[tag].type

    def known(self, path: str) -> bool:
        """Tell whether the path is configured, itself or as the beginning of a configured one."""
        return any(tag == path or tag.startswith(f"{path}/") for tag in self._elements)

    def take(self, tags: tuple[str, ...]) -> tuple[Entry, ...] | None:
        """Remove and return the next entry of each tag; None, and nothing removed, if one of them is empty."""
        if any(not self._memories[tag] for tag in tags):
            return None
        entries: list[Entry] = []
        for tag in tags:
            memory = self._memories[tag]
            fifo = self._elements[tag].mode is Buffering.FIFO
            entries.append(memory.popleft() if fifo else memory.pop())
        return tuple(entries)

    def count(self, path: str) -> int:
        """Return how many values wait: of the element, of the attributes of a node, or of all below it (the most)."""
        if path in self._memories:
            return len(self._memories[path])
        attributes = [len(m) for tag, m in self._memories.items() if tag.startswith(f"{path}/@")]
        if attributes:
            return min(attributes)
        return max((len(m) for tag, m in self._memories.items() if tag.startswith(f"{path}/")), default=0)

    def clear(self, path: str) -> None:
        """Empty the memory of the element and all below it."""
        for tag, memory in self._memories.items():
            if tag == path or tag.startswith(f"{path}/"):
                memory.clear()
