"""Where does one telegram end and the next begin?  Bytes of a TCP stream to whole telegrams; pure, no socket.

EKI sends no length, no terminator and no XML declaration: a telegram ends with the end tag of its root.  One segment
may hold several telegrams or a part of one, and peers pad with spaces, line ends and NUL.  What is not a telegram is
reported once and skipped, so that a good telegram after garbage is still found.
"""

import re

__all__ = ["MAX_TELEGRAM_BYTES", "Framer", "FramingError"]

MAX_TELEGRAM_BYTES = 64 * 1024
_PADDING = b" \t\r\n\x00"
_SHOWN_BYTES = 40


class FramingError(ValueError):
    """Bytes that belong to no telegram: garbage, a torn telegram, or one larger than MAX_TELEGRAM_BYTES."""


class Framer:
    """Cuts the stream of one connection.  Holds at most MAX_TELEGRAM_BYTES and one chunk."""

    def __init__(self, *roots: str) -> None:
        names = b"|".join(re.escape(root.encode("ascii")) for root in roots)
        self._start = re.compile(rb"<(?:" + names + rb")(?=[\s/>])")
        self._end = re.compile(rb"</(?:" + names + rb")\s*>")
        self._longest_tag = max(len(root) for root in roots) + 8
        self._buffer = bytearray()
        self._searched = 0

    @property
    def pending(self) -> int:
        """Bytes held because their telegram is not complete."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[bytes | FramingError]:
        """Return the telegrams that are complete now, and an error in the place of each run of lost bytes."""
        events: list[bytes | FramingError] = []
        self._buffer += data
        while (match := self._end.search(self._buffer, self._searched)) is not None:
            self._take(match.end(), events)
        self._buffer[:] = self._buffer.lstrip(_PADDING)
        if len(self._buffer) > MAX_TELEGRAM_BYTES:
            events.append(
                FramingError(
                    f"{len(self._buffer)} bytes without a telegram's end; the limit is {MAX_TELEGRAM_BYTES}: dropped"
                )
            )
            self._buffer.clear()
        # An end tag may be split over two chunks, and white space may stand before its bracket.
        self._searched = max(0, self._buffer.rfind(b"</", max(0, len(self._buffer) - 256)))
        if self._searched == 0:
            self._searched = max(0, len(self._buffer) - self._longest_tag)
        return events

    def _take(self, end: int, events: list[bytes | FramingError]) -> None:
        chunk = bytes(self._buffer[:end])
        del self._buffer[:end]
        self._searched = 0
        start = -1
        for match in self._start.finditer(chunk):
            start = match.start()  # the last one: an earlier start without an end is a torn telegram
        lost = chunk if start < 0 else chunk[:start]
        if lost.strip(_PADDING):
            events.append(
                FramingError(f"{len(lost)} bytes belong to no telegram: {lost.strip(_PADDING)[:_SHOWN_BYTES]!r}")
            )
        if start >= 0:
            if end - start > MAX_TELEGRAM_BYTES:
                events.append(FramingError(f"a telegram of {end - start} bytes; the limit is {MAX_TELEGRAM_BYTES}"))
            else:
                events.append(chunk[start:])
