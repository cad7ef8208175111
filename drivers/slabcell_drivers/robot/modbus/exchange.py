"""Is there a request, and may its answer be shown?  The cell's side of the handshake; pure.

A gateway may bring back what a PLC wrote long ago.  So sequence numbers only rise: a request that is neither the last
one again nor newer is refused here, and the cell never hears of it.  The refusal tells the last number, from which a
PLC that has lost its own counts on.

A request stands while the toggle of the request differs from that of the answer.  It is taken once it is whole, and
taken once: until its answer is shown the cell works on it, whatever is written meanwhile.  If by then the PLC asks
something else, because it has given up and begun anew, the answer is dropped and the new request is taken.
"""

from collections.abc import Sequence

from slabcell_drivers.robot.message import printable
from slabcell_drivers.robot.modbus.codec import InvalidRequestError, decode_request, encode_answer
from slabcell_drivers.robot.modbus.register_map import Area, RegisterMap
from slabcell_drivers.robot.protocol import Answer, Request, RequestType, ResultCode

__all__ = ["Exchange"]

STALE = "Old request. Count on from the answer's sequence number."


class Exchange:
    """The state of the handshake: which toggle was answered, and what is being worked on."""

    def __init__(self, register_map: RegisterMap) -> None:
        self._map = register_map
        self._answered = 0
        self._publication = 0
        self._taken: list[int] | None = None
        self._last: list[int] = []
        self._last_sequence = -1
        self.stale = 0
        """How often an old request was refused."""
        self.torn = 0
        """How often a request was seen that was not whole (yet)."""

    @property
    def busy(self) -> bool:
        """Whether a request is taken and not yet answered."""
        return self._taken is not None

    def resume(self, answer_words: Sequence[int]) -> None:
        """Go on where the answer area stands, as it is found in a PLC's memory."""
        start = self._map.span(Area.ANSWER)[0]
        publication, toggle = (self._map.register(Area.ANSWER, name) for name in ("publication", "toggle"))
        self._answered = answer_words[toggle.address - start] & 1
        self._publication = self._map.number(
            publication, answer_words[publication.address - start : publication.end - start]
        )

    def correct(self, answer_toggle: int) -> None:
        """Believe the toggle that is found in a PLC's memory: a write of ours may have come there late."""
        if not self.busy:
            self._answered = answer_toggle & 1

    def take(self, request_words: Sequence[int]) -> Request | Answer | None:
        """Return the request that stands, if it is new and whole; or the answer that the link itself gives to it.

        A value out of range is answered as a bad request; a heartbeat is answered at once.
        """
        if self.busy or request_words[-1] == self._answered:
            return None
        if not self._map.sound(Area.REQUEST, request_words):
            self.torn += 1
            return None
        self._taken = list(request_words)
        session, sequence = (self._number(name, request_words) for name in ("session", "sequence"))
        if self._taken[:-1] != self._last and sequence <= self._last_sequence:
            self.stale += 1
            return Answer(session, self._last_sequence, sequence, ResultCode.BAD_REQUEST, message=STALE)
        self._last, self._last_sequence = self._taken[:-1], sequence
        try:
            request = decode_request(self._map, request_words)
        except InvalidRequestError as error:
            return Answer(
                *(error.session, error.sequence, error.sequence, ResultCode.BAD_REQUEST), message=printable(str(error))
            )
        if request.type is RequestType.HEARTBEAT:
            return Answer(request.session, request.sequence, request.sequence)
        return request

    def show(self, answer: Answer, request_words: Sequence[int]) -> list[int] | None:
        """Return the words of the answer area; None if another request stands by now, which has to be taken instead.

        Raises RegisterValueError if the answer cannot be written.
        """
        taken, self._taken = self._taken, None
        if taken is None:
            raise RuntimeError("no request was taken")
        if list(request_words) != taken and self._map.sound(Area.REQUEST, request_words):
            return None
        self._publication = (self._publication + 1) & 0xFFFFFFFF
        self._answered = taken[-1]
        return encode_answer(self._map, answer, publication=self._publication, toggle=self._answered)

    def _number(self, name: str, request_words: Sequence[int]) -> int:
        register, start = self._map.register(Area.REQUEST, name), self._map.span(Area.REQUEST)[0]
        return self._map.number(register, request_words[register.address - start : register.end - start])

    def drop(self) -> None:
        """Forget the request that was taken: it still stands, and will be taken again."""
        self._taken = None
