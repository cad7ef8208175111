"""How is one whole, fresh frame taken for one trigger, whatever library brings it?  Flush, trigger, wait, judge, retry.

A source knows a library; this module knows which of its frames may be delivered, and what is tried before a bad one
becomes an error.  All of it blocks, on the thread that owns the source.
"""

import time
from collections.abc import Callable, Iterable
from typing import Final, Generic, Protocol, TypeVar

from slabcell_drivers.camera.protocol import CameraIncomplete, CameraTimeout
from slabcell_drivers.camera.sequence import FrameSequence, Verdict
from slabcell_drivers.camera.settings import CameraStatistics

__all__ = ["Source", "Taker"]

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

PRIMING_S: Final = 2.0
PRIMING_TRIES: Final = 3
RETRY_NEEDS_S: Final = 0.02
"""With less time left than this, a bad frame is not taken again."""


class Source(Protocol[T_co]):
    """A camera whose acquisition runs and that waits for triggers.  Every call may raise the library's own errors."""

    @property
    def name(self) -> str:
        """What people call the camera."""
        ...

    def restart(self) -> None:
        """Begin the acquisition anew, so that no frame of before can come any more."""
        ...

    def leftovers(self) -> Iterable[int | None]:
        """Give back every frame that nobody waits for, and yield their ids."""
        ...

    def trigger(self) -> None:
        """Send the software trigger."""
        ...

    def wait(self, triggered_s: float, deadline_s: float, wanted: Callable[[int | None], bool]) -> T_co | None:
        """Return the next whole frame whose id is wanted, None when the time is over.  Raises CameraIncomplete."""
        ...


class Taker(Generic[T]):
    """Takes frames from a source, and counts what happens."""

    def __init__(self, source: Source[T], statistics: CameraStatistics) -> None:
        self._source = source
        self._statistics = statistics
        self._sequence = FrameSequence()
        self._doubtful = True

    def prime(self, deadline_s: float) -> None:
        """Take frames until one is whole: after every start the first is often not.

        Raises CameraIncomplete, CameraTimeout.
        """
        for attempt in range(1, PRIMING_TRIES + 1):
            self._sequence = FrameSequence()
            try:
                self._shoot(min(time.monotonic() + PRIMING_S, deadline_s))
            except CameraIncomplete:
                if attempt == PRIMING_TRIES:
                    raise
            else:
                return

    def snap(self, deadline_s: float) -> T:
        """Trigger and return the frame; one bad frame is taken again while there is time.

        Raises CameraIncomplete, CameraTimeout.
        """
        if self._doubtful:
            self._restart(deadline_s)
        first_s = time.monotonic() + max(0.5 * (deadline_s - time.monotonic()), 0.05)
        try:
            return self._shoot(min(first_s, deadline_s))
        except (CameraIncomplete, CameraTimeout):
            if time.monotonic() >= deadline_s - RETRY_NEEDS_S:
                raise
            self._statistics.retries += 1
            self._restart(deadline_s)
            return self._shoot(deadline_s)

    def _restart(self, deadline_s: float) -> None:
        self._doubtful = True
        self._statistics.restarts += 1
        self._source.restart()
        self.prime(deadline_s)

    def _shoot(self, deadline_s: float) -> T:
        self._doubtful = True  # until a frame has come, any frame that comes may be an old one
        for frame_id in self._source.leftovers():
            self._statistics.stale += 1
            if frame_id is not None:
                self._sequence.judge(frame_id)  # it is counted, so that the next one is known
        triggered_s = time.monotonic()
        self._source.trigger()
        try:
            frame = self._source.wait(triggered_s, deadline_s, self._wanted)
        except CameraIncomplete:
            self._statistics.incomplete += 1
            raise
        if frame is None:
            self._statistics.timeouts += 1
            raise CameraTimeout(
                f"camera {self._source.name}: no frame within {time.monotonic() - triggered_s:.2f} s of the trigger;"
                " check exposure time, trigger source and network"
            )
        self._doubtful = False
        return frame

    def _wanted(self, frame_id: int | None) -> bool:
        """Say whether a whole frame answers the trigger.  Raises CameraIncomplete if that cannot be known."""
        if frame_id is None:
            return True  # a producer that counts nothing: after a flush, the next frame is taken for the trigger's
        missed = self._sequence.missed(frame_id)
        match self._sequence.judge(frame_id):
            case Verdict.OWN:
                return True
            case Verdict.STALE:
                self._statistics.stale += 1
                return False
            case Verdict.BROKEN:
                self._statistics.gaps += max(1, missed)
                raise CameraIncomplete(
                    f"camera {self._source.name}: frame {frame_id} came, {self._sequence.expected} was next: the count"
                    " is broken, so the frame cannot be told to be new"
                )
