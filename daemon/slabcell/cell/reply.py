"""What is the robot told?  A reply without the numbers of the exchange, which the cell adds."""

from dataclasses import dataclass

from slabcell.catalogue import Fault, entry
from slabcell.cell.records import OfferRecord
from slabcell_drivers.robot.protocol import Answer, Offer, Request, ResultCode

__all__ = ["Reply", "refusal", "to_answer"]

FIRST_FAULT = 1000
"""Codes from here on are numbers of the error catalogue."""


@dataclass(frozen=True, slots=True)
class Reply:
    """A code, how many results are still to be fetched, one of them, and a text for the robot's display.

    The catalogue's words stand for an empty message where the code is a number of the catalogue.
    """

    code: int = ResultCode.OK
    left: int = 0
    offer: OfferRecord | None = None
    message: str = ""


def refusal(fault: Fault) -> Reply:
    """Return the reply to a request that the robot should not have made."""
    return Reply(ResultCode.BAD_REQUEST, message=entry(fault).robot)


def to_answer(reply: Reply, request: Request, *, session: int, trigger_sequence: int) -> Answer:
    """Return the whole answer."""
    offer = reply.offer
    return Answer(
        session=session,
        sequence=request.sequence,
        acknowledges=request.sequence,
        code=int(reply.code),
        left=reply.left,
        trigger_sequence=trigger_sequence,
        offer=Offer(offer.result_id, offer.index, offer.slot, offer.pick, offer.place, offer.score) if offer else None,
        message=reply.message or (entry(reply.code).robot if reply.code >= FIRST_FAULT else ""),
    )
