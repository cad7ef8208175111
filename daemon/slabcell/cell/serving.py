"""What is each request of the robot answered, and what is done for it?  One request at a time.

Whatever the robot may act on is in the ledger before the answer is given, and so is every acknowledgement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import structlog

from slabcell.catalogue import Fault
from slabcell.cell.alarms import Alarms
from slabcell.cell.conversation import Conversation
from slabcell.cell.cycles import Cycles
from slabcell.cell.desk import JobDesk
from slabcell.cell.execution import Execution
from slabcell.cell.handover import Handover
from slabcell.cell.records import JobState
from slabcell.cell.reply import Reply
from slabcell.cell.states import CellEvent, CellState, Conditions, HeldCause, StateMachine, SuspendedCause
from slabcell.errors import SlabcellError
from slabcell_drivers.robot.protocol import AckState, Request, RequestType, ResultCode

__all__ = ["Serving"]

NEEDS_EYES = frozenset({Fault.PART_LOST, Fault.PLACEMENT_UNKNOWN})
"""Alarms of results that are unknown: nothing is picked until a person has looked."""

_UNDER_WAY = frozenset({AckState.NONE, AckState.ACCEPTED, AckState.GRASPED})
"""What the robot says of a slab that it is not done with."""


class Serving:
    """Answers requests; the caller serialises them.  With ``stepping`` the cell halts after the next slab."""

    def __init__(
        self,
        machine: StateMachine,
        desk: JobDesk,
        execution: Execution,
        cycles: Cycles,
        handover: Handover,
        *,
        alarms: Alarms,
        conditions: Conditions,
    ) -> None:
        self.conversation = Conversation()
        self.stepping = False
        self._machine = machine
        self._desk = desk
        self._execution = execution
        self._cycles = cycles
        self._handover = handover
        self._alarms = alarms
        self._conditions = conditions
        self._log = structlog.stdlib.get_logger("slabcell.cell")

    async def reply(self, request: Request, say: Callable[[Reply], None]) -> Reply:
        """Return what to say to a request that was not answered before; never raises.

        ``say`` is called where that is known earlier: what is returned then, a fault, the robot has to hear later.
        """
        try:
            match request.type:
                case RequestType.HELLO:
                    return await self._hello(request)
                case RequestType.TRIGGER:
                    return await self._trigger(request, say)
                case RequestType.NEXT:
                    return await self._next(request)
                case RequestType.ACK:
                    return await self._acknowledge(request)
                case RequestType.HEARTBEAT:
                    return Reply()
                case RequestType.BYE:
                    return await self._bye(request)
        except SlabcellError as error:
            return await self._fault(Fault(error.number) if error.number else Fault.INTERNAL, str(error))
        except Exception as error:  # noqa: BLE001 - the robot gets an answer in any case, and the cell stops
            self._log.exception("request failed", type=request.type.name)
            return await self._fault(Fault.INTERNAL, f"{type(error).__name__}: {error}")

    async def _fault(self, fault: Fault, detail: str) -> Reply:
        self._alarms.come(fault, detail)
        if self._machine.state not in {CellState.ERROR, CellState.PREOPERATIONAL}:
            self._cycles.end()
            await self._machine.fire(CellEvent.FAULT, detail)
        return Reply(fault)

    async def unresolved(self) -> Fault | None:
        """Raise the alarms of what a person has to look at; return one of them, or None if nothing is open."""
        faults: list[Fault] = []
        for offer in await self._desk.unknown():
            faults.append(Fault(offer.fault) if offer.fault else Fault.PLACEMENT_UNKNOWN)
            self._alarms.come(faults[-1], f"result {offer.result_id}, slot {offer.slot}: {offer.reason}")
        for fault in NEEDS_EYES - set(faults):
            self._alarms.settle(fault, "every result is resolved")
        return faults[-1] if faults else None

    async def halt(self, cause: str) -> None:
        """Offer nothing any more, even where the ledger refuses.  What the robot holds it may still lay down."""
        self._cycles.end()
        await self._machine.fire(CellEvent.HALT, cause)
        self.stepping = False
        try:
            await self._desk.void(cause)
        except SlabcellError as error:
            self._alarms.come(Fault(error.number) if error.number else Fault.LEDGER_ERROR, str(error))

    # Greeting and leaving

    async def _hello(self, request: Request) -> Reply:
        if self._machine.state is CellState.PREOPERATIONAL:
            return Reply(Fault.NOT_READY)
        session, outcome = await self._desk.greet(request)
        self.conversation.begin(session, request.sequence)
        self._conditions.suspended = None
        self._cycles.end()
        for fault, detail in outcome.faults:
            self._alarms.come(fault, detail)
        if self._machine.state.is_executing:
            await self._machine.fire(CellEvent.ABANDON, "the robot greeted anew")
        if outcome.resume is None:
            return Reply()
        if self._machine.state is CellState.READY:
            await self._machine.fire(CellEvent.OFFER, f"result {outcome.resume.result_id} is still in the gripper")
        return Reply(left=1, offer=outcome.resume)

    async def _bye(self, request: Request) -> Reply:
        await self._desk.void("the robot program ended", session=request.session)
        self._cycles.end()
        if self._machine.state.is_executing:
            await self._machine.fire(CellEvent.ABANDON, "the robot program ended")
        self._conditions.suspended = SuspendedCause.ROBOT_ABSENT
        return Reply()

    # A cycle

    async def _trigger(self, request: Request, say: Callable[[Reply], None]) -> Reply:
        if self._conditions.held is HeldCause.CALIBRATION:
            return Reply(Fault.CALIBRATION_MISSING)
        if self._machine.state not in {CellState.READY, CellState.OFFERING}:
            return self._not_ready()
        job = await self._desk.job_for(request)
        if job is not None and job.state is not JobState.OPEN:
            return Reply(ResultCode.JOB_COMPLETE)
        await self._handover.drop_unfinished(request)
        if self._machine.state is CellState.OFFERING:
            await self._machine.fire(CellEvent.FINISH, "a new picture was asked for")
        blocking = await self.unresolved()
        if blocking is not None:
            self._conditions.held = HeldCause.OPERATOR
            return Reply(blocking)
        if request.status.gripper_holds_part:
            self._alarms.come(Fault.GRIPPER_NOT_EMPTY, "a part is in the gripper when a picture is asked for")
            return Reply(Fault.GRIPPER_NOT_EMPTY)
        self._alarms.cease(Fault.GRIPPER_NOT_EMPTY)
        self.conversation.trigger_sequence = request.sequence
        return await self._execution.run(request, job, say)

    def _not_ready(self) -> Reply:
        standing = self._alarms.standing
        return Reply(standing[-1].fault if standing else Fault.NOT_READY)

    async def _next(self, request: Request) -> Reply:
        reply = await self._handover.next(request, begun_only=self._machine.state is CellState.HALTED)
        # Results that were announced and could not be written are not "none": the robot must not go on as if.
        nothing = reply.offer is None and reply.code == ResultCode.OK
        return self._not_ready() if nothing and self._machine.state is CellState.ERROR else reply

    async def _acknowledge(self, request: Request) -> Reply:
        reply = await self._handover.acknowledge(request)
        settled = reply.code == ResultCode.OK and request.ack_state not in _UNDER_WAY
        if settled and self.stepping and self._machine.state in {CellState.READY, CellState.OFFERING}:
            await self.halt("one slab is done: step")
            return replace(reply, left=0)
        if reply.left == 0 and self._machine.state is CellState.OFFERING and not await self._desk.open_offers():
            self._cycles.end()
            await self._machine.fire(CellEvent.FINISH, "every result is settled")
        return reply
