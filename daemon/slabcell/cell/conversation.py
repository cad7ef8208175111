"""Has this request been answered already?  The session with the robot, and the answers given in it.

A request is known by its session and its sequence number.  The same request again gets the same answer and has no
other effect; the same number with other content, or a number that lies before, is refused.
"""

from collections import OrderedDict

from slabcell.catalogue import Fault
from slabcell_drivers.robot.protocol import Answer, Request, RequestType

__all__ = ["Conversation"]

REMEMBERED_ANSWERS = 64
"""A robot in lock-step repeats its last request only; the rest is margin for duplicates on the way."""


class Conversation:
    """The present session: its number, that of its last trigger, the last sequence number, and the last answers."""

    def __init__(self) -> None:
        self.session = 0
        self.trigger_sequence = 0
        self._last = -1
        self._answers: OrderedDict[int, tuple[Request, Answer]] = OrderedDict()
        self._greeting: tuple[Request, Answer] | None = None

    def begin(self, session: int, sequence: int) -> None:
        """Start over with a new session, greeted with this sequence number."""
        self.session = session
        self.trigger_sequence = 0
        self._last = sequence
        self._answers.clear()
        self._greeting = None

    def recall(self, request: Request) -> Answer | None:
        """Return the answer that this very request has got, if any."""
        if request.type is RequestType.HELLO:
            # A greeting carries no session yet: it is the same only if nothing was said since.
            known = self._greeting if not self._answers else None
        else:
            known = self._answers.get(request.sequence) if request.session == self.session else None
        return known[1] if known is not None and known[0] == request else None

    def refuse(self, request: Request) -> Fault | None:
        """Return why a request cannot be taken, or None.  A greeting can always be."""
        if request.type is RequestType.HELLO:
            return None
        if self.session == 0 or request.session != self.session:
            return Fault.ROBOT_SESSION
        return Fault.ROBOT_SEQUENCE if request.sequence <= self._last else None

    def remember(self, request: Request, answer: Answer) -> None:
        """Keep the answer of a request that was taken."""
        if request.type is RequestType.HELLO:
            self._greeting = (request, answer)
            return
        self._last = request.sequence
        self._answers[request.sequence] = (request, answer)
        while len(self._answers) > REMEMBERED_ANSWERS:
            self._answers.popitem(last=False)
