"""How often may the same log line come?  So that a fault that repeats itself neither fills the disk nor hides the rest.

Lines are the same if logger, level and event are; their fields may differ.  Each kind has a bucket of lines that fills
up again with time.  A line that is held back is counted, and the next of its kind that gets through says how many were.
"""

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import structlog
from structlog.typing import EventDict, WrappedLogger

__all__ = ["RateLimit"]

BURST = 200
PER_SECOND = 5.0
MAX_KINDS = 512


@dataclass(slots=True)
class _Bucket:
    lines: float
    filled_s: float
    held_back: int = 0


class RateLimit:
    """A processor of structlog.  Errors that stop the process (level critical) always get through."""

    def __init__(
        self, *, burst: int = BURST, per_second: float = PER_SECOND, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._burst = burst
        self._per_second = per_second
        self._clock = clock
        self._buckets: OrderedDict[tuple[str, str, str], _Bucket] = OrderedDict()

    def __call__(self, _: WrappedLogger, __: str, event: EventDict) -> EventDict:
        """Return the line, with ``held_back`` if others were before it; raises DropEvent to hold it back."""
        level = str(event.get("level"))
        if level == "critical":
            return event
        kind = (str(event.get("logger", "")), level, str(event.get("event"))[:200])
        now_s = self._clock()
        bucket = self._buckets.pop(kind, None) or _Bucket(float(self._burst), now_s)
        self._buckets[kind] = bucket  # the most recent last
        while len(self._buckets) > MAX_KINDS:
            self._buckets.popitem(last=False)
        bucket.lines = min(float(self._burst), bucket.lines + (now_s - bucket.filled_s) * self._per_second)
        bucket.filled_s = now_s
        if bucket.lines < 1.0:
            bucket.held_back += 1
            raise structlog.DropEvent
        bucket.lines -= 1.0
        if bucket.held_back:
            event["held_back"], bucket.held_back = bucket.held_back, 0
        return event
