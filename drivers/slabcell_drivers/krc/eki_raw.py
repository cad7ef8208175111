"""Where does one raw telegram end in a stream of bytes?  By a fixed size (BYTE) or by an ending (STREAM)."""

from slabcell_drivers.krc.eki_config import ElementType, ReceiveElement

__all__ = ["RawSplitter"]


class RawSplitter:
    """Cuts a stream as the one RAW element of a channel says.

    A stream without an ending, or one that reaches its size before its ending, is cut at what there is.
    """

    def __init__(self, element: ReceiveElement) -> None:
        self._element = element
        self._pending = bytearray()

    @property
    def pending_bytes(self) -> int:
        """How many bytes wait for the rest of their telegram."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes; return the telegrams that are now complete, without their endings."""
        self._pending += data
        telegrams: list[bytes] = []
        while (cut := self._next_cut()) is not None:
            end, skip = cut
            telegrams.append(bytes(self._pending[:end]))
            del self._pending[: end + skip]
        return telegrams

    def _next_cut(self) -> tuple[int, int] | None:
        """Return where the next telegram ends and how long its ending is."""
        waiting, size = len(self._pending), self._element.size
        if self._element.type is ElementType.BYTE:
            return (size, 0) if waiting >= size else None
        found = [(at, len(eos)) for eos in self._element.end_of_stream if eos and (at := self._pending.find(eos)) >= 0]
        if found:
            return min(found, key=lambda cut: (cut[0], -cut[1]))
        if size and waiting >= size:
            return (size, 0)
        no_ending = not any(self._element.end_of_stream)
        return (waiting, 0) if waiting and no_ending and not size else None

    def clear(self) -> None:
        """Forget what is pending."""
        self._pending.clear()
