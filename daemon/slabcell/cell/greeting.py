"""What does the ledger look like after the robot has greeted?  Settles what was under way when the link was lost."""

from dataclasses import dataclass

from slabcell.catalogue import Fault
from slabcell.cell.ledger import LedgerFile
from slabcell.cell.reconcile import Decision, reconcile
from slabcell.cell.records import OfferRecord, OfferState
from slabcell_drivers.robot.protocol import AckState, Request

__all__ = ["Settlement", "settle"]

_UNDER_WAY = frozenset({OfferState.OFFERED, OfferState.ACCEPTED, OfferState.GRASPED})


@dataclass(frozen=True, slots=True)
class Settlement:
    """What came out: the result that the robot shall go on with, what was moved, and the alarms to raise."""

    resume: OfferRecord | None
    moved: tuple[OfferRecord, ...]
    faults: tuple[tuple[Fault, str], ...]


def settle(book: LedgerFile, job_id: int | None, request: Request, session: int) -> Settlement:
    """Bring the ledger and what the robot says together; runs in the ledger's thread.

    ``request`` is a greeting: it says which result the robot last acted on, how far it got, and whether its gripper
    holds a part.
    """
    if request.ack_result_id > 0:
        book.keep_above(request.ack_result_id)
    holds = request.status.gripper_holds_part
    moved: list[OfferRecord] = []
    faults: list[tuple[Fault, str]] = []
    resume: OfferRecord | None = None
    for offer in book.offers(job_id) if job_id is not None else ():
        if offer.state not in _UNDER_WAY:
            continue
        named = offer.result_id == request.ack_result_id
        said = request.ack_state if named else AckState.NONE
        decision: Decision = reconcile(offer.state, said, holds_part=holds and (named or request.ack_result_id == 0))
        after = book.move(
            offer.result_id,
            decision.state,
            session=session,
            sequence=request.sequence,
            reason=decision.reason,
            fault=decision.fault or 0,
        )
        moved.append(after)
        if decision.resume:
            resume = after
        if decision.fault is not None:
            faults.append((decision.fault, f"result {offer.result_id}, slot {offer.slot}: {decision.reason}"))
    if job_id is not None:
        for result_id in book.void(job_id, session=session, reason="the link was lost before it was offered"):
            voided = book.offer(result_id)
            if voided is not None:
                moved.append(voided)
    if holds and resume is None and not faults:
        faults.append((Fault.GRIPPER_NOT_EMPTY, f"the robot last knew result {request.ack_result_id}"))
    return Settlement(resume, tuple(moved), tuple(faults))
