"""How do results get from the ledger to the robot, and its acknowledgements back?  NEXT and ACK."""

from __future__ import annotations

from collections.abc import Callable

from slabcell.catalogue import Fault
from slabcell.cell.alarms import Alarms
from slabcell.cell.desk import JobDesk
from slabcell.cell.events import Event, Offered
from slabcell.cell.reconcile import given_up
from slabcell.cell.records import HAND_STATES, OfferState
from slabcell.cell.reply import Reply, refusal
from slabcell_drivers.robot.protocol import AckState, Request

__all__ = ["Handover"]

_O = OfferState
_SAID = {AckState.ACCEPTED: _O.ACCEPTED, AckState.GRASPED: _O.GRASPED, AckState.PLACED: _O.PLACED}
_UNDER_WAY = frozenset({_O.OFFERED, _O.ACCEPTED, _O.GRASPED})
_DISTURBS = frozenset({AckState.PICK_FAILED, AckState.ABORTED})
"""After these the slabs may lie elsewhere than in the picture."""


class Handover:
    """Offers one result after the other, and writes what the robot says of them.  May raise LedgerError."""

    def __init__(self, desk: JobDesk, *, alarms: Alarms, emit: Callable[[Event], None]) -> None:
        self._desk = desk
        self._alarms = alarms
        self._emit = emit

    async def next(self, request: Request, *, begun_only: bool = False) -> Reply:
        """Return the result that the robot shall act on: the same one until it is accepted.

        With ``begun_only`` nothing is offered that was not offered before.
        """
        waiting = [item for item in await self._desk.open_offers() if not begun_only or item.state is not _O.PLANNED]
        if not waiting:
            return Reply()
        offer = next((item for item in waiting if item.state is not _O.PLANNED), waiting[0])
        if offer.state is _O.ACCEPTED:
            return refusal(Fault.ROBOT_MUST_FINISH)
        if offer.state is _O.PLANNED:
            offer = await self._desk.move(offer, _O.OFFERED, request)
        self._emit(Offered(offer))
        return Reply(left=len(waiting), offer=offer)

    async def acknowledge(self, request: Request) -> Reply:
        """Write how far the robot got; return how many results are left."""
        offer = await self._desk.find(request.ack_result_id)
        said = request.ack_state
        if offer is None or said is AckState.NONE:
            return refusal(Fault.ROBOT_ACKNOWLEDGES_UNKNOWN)
        if said in _SAID:
            state, reason, fault = _SAID[said], "", None
        else:
            decision = given_up(offer.state, said, holds_part=request.status.gripper_holds_part)
            state, reason, fault = decision.state, decision.reason, decision.fault
        if offer.state is not state:
            if offer.state not in _UNDER_WAY or (offer.state, state) == (_O.GRASPED, _O.ACCEPTED):
                return refusal(Fault.ROBOT_ACKNOWLEDGES_UNKNOWN)
            disturbed = "the table may be disturbed" if said in _DISTURBS else ""
            await self._desk.move(offer, state, request, reason, fault, void_others=disturbed)
            if fault is not None:
                self._alarms.come(fault, f"result {offer.result_id}, slot {offer.slot}: {reason}")
        return Reply(left=len(await self._desk.open_offers()))

    async def drop_unfinished(self, request: Request) -> None:
        """Settle what the robot leaves behind by asking for a new picture."""
        for offer in await self._desk.open_offers():
            if offer.state in HAND_STATES:
                decision = given_up(offer.state, AckState.ABORTED, holds_part=request.status.gripper_holds_part)
                await self._desk.move(offer, decision.state, request, decision.reason, decision.fault)
                if decision.fault is not None:
                    self._alarms.come(decision.fault, f"result {offer.result_id}: {decision.reason}")
        await self._desk.void("a new picture was asked for", session=request.session)
