"""Does a frame belong to the trigger that was just sent?  Judged by the camera's own count of its frames.

A triggered camera counts one frame for each trigger, so the next frame's id is known.  GigE Vision 1.x counts 1 to
65535 and goes on with 1 (0 is never used); extended ids (GigE Vision 2, other transports) have 64 bits and go on.
"""

from enum import Enum
from typing import Final

__all__ = ["FrameSequence", "Verdict"]

IDS_16: Final = 65_535
RECENT: Final = 1000
"""An id so few before the expected one is an old frame; anything else is a count that jumped."""


class Verdict(Enum):
    """What a frame is."""

    OWN = "own"  # it answers the trigger
    STALE = "stale"  # it answers an earlier trigger
    BROKEN = "broken"  # frames in between are missing, or the camera began to count again


class FrameSequence:
    """The count of one acquisition; the first id is whatever the camera begins with."""

    def __init__(self) -> None:
        self._last: int | None = None

    @property
    def expected(self) -> int | None:
        """The id of the next frame, None before the first; after 65535, 65536 is as good as 1."""
        if self._last is None:
            return None
        return 1 if self._last == IDS_16 else self._last + 1

    def judge(self, frame_id: int) -> Verdict:
        """Say what a frame is, and count it if it is the trigger's own."""
        if self._last is None or frame_id in (self.expected, self._last + 1):
            self._last = frame_id
            return Verdict.OWN
        return Verdict.STALE if 0 < -self._ahead(frame_id) <= RECENT else Verdict.BROKEN

    def missed(self, frame_id: int) -> int:
        """Return how many frames are missing before ``frame_id``, 0 if that cannot be known."""
        if self._last is None or frame_id in (self.expected, self._last + 1):
            return 0
        ahead = self._ahead(frame_id)
        return ahead if 0 < ahead <= RECENT else 0

    def _ahead(self, frame_id: int) -> int:
        """Return how far an id is from the expected one: behind is negative."""
        last = self._last or 0
        if max(last, frame_id) > IDS_16:  # extended: it does not wrap
            return frame_id - last - 1
        forward = (frame_id - last - 1) % IDS_16
        return forward if forward <= RECENT else forward - IDS_16
