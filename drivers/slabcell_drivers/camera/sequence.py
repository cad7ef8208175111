"""Does a frame belong to the trigger that was just sent?  Judged by the camera's own count of its frames.

A triggered camera counts one frame for each trigger, so the next frame's id is known.  GigE Vision 1.x counts 1 to
65535 and goes on with 1 (0 is never used); extended ids have 64 bits and do not wrap.
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

    def __init__(self, *, extended: bool = False) -> None:
        self._extended = extended
        self._last: int | None = None

    @property
    def expected(self) -> int | None:
        """The id of the next frame, None before the first."""
        if self._last is None:
            return None
        return self._last + 1 if self._extended else self._last % IDS_16 + 1

    def judge(self, frame_id: int) -> Verdict:
        """Say what a frame is, and count it if it is the trigger's own."""
        expected = self.expected
        if expected is None or frame_id == expected:
            self._last = frame_id
            return Verdict.OWN
        behind = expected - frame_id if self._extended else (expected - frame_id) % IDS_16
        return Verdict.STALE if 0 < behind <= RECENT else Verdict.BROKEN

    def missed(self, frame_id: int) -> int:
        """Return how many frames are missing before ``frame_id``, 0 if that cannot be known."""
        expected = self.expected
        if expected is None or frame_id == expected:
            return 0
        ahead = frame_id - expected if self._extended else (frame_id - expected) % IDS_16
        return ahead if 0 < ahead <= RECENT else 0
