"""The cell: what does it answer to each request of the robot, and what does it do for it?

The robot asks in lock-step; requests are served one after the other.  Whatever the robot may act on is in the ledger
before the answer leaves, and so is every acknowledgement.  It is *not* responsible for opening devices or for the
robot's connection: the service is.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable

import structlog

from slabcell.calibration.model import Calibration
from slabcell.catalogue import Fault, entry
from slabcell.cell.alarms import Alarms
from slabcell.cell.bundle import BundleWriter
from slabcell.cell.conversation import Conversation
from slabcell.cell.cycles import Cycles
from slabcell.cell.desk import JobDesk
from slabcell.cell.events import CycleRecord, Event, Offered, StateChanged, Subscriber, Verified
from slabcell.cell.eyes import Eyes, HouseEyes
from slabcell.cell.ledger import Ledger
from slabcell.cell.looking import CAMERA_FAULTS, LookError, Looking
from slabcell.cell.reconcile import given_up
from slabcell.cell.records import HAND_STATES, Job, JobState, OfferRecord, OfferState, PlacementRecord
from slabcell.cell.settings import CellSettings
from slabcell.cell.states import CellEvent, CellState, HeldCause, StateMachine, SuspendedCause
from slabcell.errors import SlabcellError
from slabcell.recipe import Recipe
from slabcell_drivers.camera.protocol import Camera, ImageFrame
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, ResultCode

__all__ = ["Cell"]

BLOCKING_FAULTS = (Fault.PART_LOST, Fault.PLACEMENT_UNKNOWN)
"""Alarms after which nothing is picked until a person has looked."""

_O = OfferState
_SAID = {AckState.ACCEPTED: _O.ACCEPTED, AckState.GRASPED: _O.GRASPED, AckState.PLACED: _O.PLACED}
_UNDER_WAY = frozenset({_O.OFFERED, _O.ACCEPTED, _O.GRASPED})
_BACKWARDS = frozenset({(_O.GRASPED, _O.ACCEPTED)})
_FINDING_FAULTS = (
    Fault.NO_MATCH,
    Fault.NOTHING_FOUND,
    Fault.IMAGE_UNUSABLE,
    Fault.VISION_SLOW,
    Fault.UNREACHABLE,
    Fault.OUTSIDE_WORKSPACE,
    Fault.COLLISION,
)


class Cell:
    """One cell with one camera and one robot.  `handle` is what a `RobotLink` needs."""

    def __init__(
        self,
        camera: Camera,
        calibration: Calibration,
        recipe: Recipe,
        *,
        arm: ArmModel,
        settings: CellSettings,
        ledger: Ledger,
        bundles: BundleWriter | None = None,
        eyes: Eyes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.recipe = recipe
        self.settings = settings
        self.alarms = Alarms(self._emit)
        self.held: HeldCause | None = None
        self.suspended: SuspendedCause | None = SuspendedCause.ROBOT_ABSENT
        self._calibration = calibration
        self._clock = clock
        self._machine = StateMachine(lambda before, after, cause: self._emit(StateChanged(before, after, cause)))
        self._desk = JobDesk(ledger, recipe, self._emit)
        self._cycles = Cycles(
            *(ledger, recipe, calibration, bundles),
            emit=self._emit,
            failed=lambda detail: self.alarms.come(Fault.BUNDLE_UNWRITABLE, detail),
        )
        self._looking = Looking(
            camera,
            calibration,
            eyes=eyes or HouseEyes(calibration, recipe),
            arm=arm,
            thickness_mm=recipe.thickness_mm,
            settings=settings,
            emit=self._emit,
            clock=clock,
        )
        self._conversation = Conversation()
        self._turn = asyncio.Lock()
        self._tasks: set[asyncio.Task[Answer]] = set()
        self._subscribers: list[Subscriber] = []
        self._log = structlog.stdlib.get_logger("slabcell.cell")

    @property
    def state(self) -> CellState:
        """Where the cell stands."""
        return self._machine.state

    @property
    def job(self) -> Job | None:
        """The job that is open, or was just finished."""
        return self._desk.job

    @property
    def cycles(self) -> deque[CycleRecord]:
        """Records of the last cycles, the present one included."""
        return self._cycles.records

    def subscribe(self, subscriber: Subscriber) -> Callable[[], None]:
        """Have ``subscriber`` called with every event, until it raises; return the function that ends it."""
        self._subscribers.append(subscriber)

        def end() -> None:
            if subscriber in self._subscribers:
                self._subscribers.remove(subscriber)

        return end

    def _emit(self, event: Event) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:  # noqa: BLE001 - a watcher must not stop the cell
                self._subscribers.remove(subscriber)
                self._log.exception("subscriber failed and is told nothing any more", subscriber=repr(subscriber))

    # Life

    async def start(self) -> None:
        """Become ready, without moving anything.  Raises CalibrationError or LedgerError."""
        self._calibration.require_plane()
        await self._machine.fire(CellEvent.INITIALIZE, "start")
        abandoned = await self._desk.take_up()
        if abandoned is not None:
            self.alarms.come(Fault.RECIPE_CHANGED, abandoned)
        for offer in await self._desk.offers():
            if offer.state is _O.UNKNOWN:
                self.alarms.come(Fault.PLACEMENT_UNKNOWN, f"result {offer.result_id}, slot {offer.slot}")
        await self._machine.fire(CellEvent.PREPARE, f"recipe {self.recipe.name}")

    async def stop(self) -> None:
        """Take back what the robot has not begun with, and end every thread; may be called twice."""
        async with self._turn:
            if self.state is not CellState.PREOPERATIONAL:
                self._cycles.end()
                try:
                    await self._desk.void("the cell was stopped")
                except SlabcellError as error:  # what is not void now is settled when the robot greets again
                    self._log.warning("offers not taken back", error=str(error))
                await self._machine.fire(CellEvent.STOP, "stop")
                self._cycles.settle()
        await asyncio.gather(*self._tasks)
        await self._looking.close()
        await self._cycles.close()

    async def clear(self) -> None:
        """Leave the error state after a person has removed its cause."""
        async with self._turn:
            await self._machine.fire(CellEvent.CLEAR, "cleared by a person")
            for alarm in self.alarms.standing:
                if entry(alarm.fault).category in {"ledger", "service"}:
                    self.alarms.acknowledge(alarm.fault)
            await self._machine.fire(CellEvent.PREPARE, f"recipe {self.recipe.name}")

    # Requests

    async def handle(self, request: Request) -> Answer:
        """Answer one request; never raises.  A caller that is cancelled does not undo what was begun."""
        task = asyncio.create_task(self._serve(request), name=f"slabcell-request-{request.type.name}")
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return await asyncio.shield(task)

    async def _serve(self, request: Request) -> Answer:
        try:
            async with asyncio.timeout(self.settings.busy_timeout_s):
                await self._turn.acquire()
        except TimeoutError:
            return self._reply(request, ResultCode.BUSY, message="Cell is busy. Ask again.")
        try:
            known = self._conversation.recall(request)
            if known is not None:
                self._log.info("request repeated", sequence=request.sequence, type=request.type.name)
                return known
            refusal = self._conversation.refuse(request)
            if refusal is not None:
                return self._refuse(request, refusal)
            before = self._cycles.present
            answer = await self._answer(request)
            self._cycles.settle(request, answer, before=before)
            self._conversation.remember(request, answer)
            return answer
        finally:
            self._turn.release()

    async def _answer(self, request: Request) -> Answer:
        try:
            match request.type:
                case RequestType.HELLO:
                    return await self._hello(request)
                case RequestType.TRIGGER:
                    return await self._trigger(request)
                case RequestType.NEXT:
                    return await self._next(request)
                case RequestType.ACK:
                    return await self._acknowledge(request)
                case RequestType.HEARTBEAT:
                    return self._reply(request)
                case RequestType.BYE:
                    return await self._bye(request)
        except SlabcellError as error:
            return await self._fault(request, Fault(error.number) if error.number else Fault.INTERNAL, str(error))
        except Exception as error:  # noqa: BLE001 - the robot gets an answer in any case, and the cell stops
            self._log.exception("request failed", type=request.type.name)
            return await self._fault(request, Fault.INTERNAL, f"{type(error).__name__}: {error}")

    async def _fault(self, request: Request, fault: Fault, detail: str) -> Answer:
        self.alarms.come(fault, detail)
        if self.state not in {CellState.ERROR, CellState.PREOPERATIONAL}:
            self._cycles.end()
            await self._machine.fire(CellEvent.FAULT, detail)
        return self._reply(request, fault)

    def _reply(
        self,
        request: Request,
        code: int = ResultCode.OK,
        *,
        left: int = 0,
        offer: OfferRecord | None = None,
        message: str = "",
    ) -> Answer:
        return Answer(
            session=self._conversation.session,
            sequence=request.sequence,
            acknowledges=request.sequence,
            code=int(code),
            left=left,
            trigger_sequence=self._conversation.trigger_sequence,
            offer=_to_offer(offer) if offer is not None else None,
            message=message or (entry(code).robot if code >= 1000 else ""),
        )

    def _refuse(self, request: Request, fault: Fault) -> Answer:
        self._log.warning("request refused", number=int(fault), type=request.type.name, sequence=request.sequence)
        return self._reply(request, ResultCode.BAD_REQUEST, message=entry(fault).robot)

    # Greeting and leaving

    async def _hello(self, request: Request) -> Answer:
        if self.state is CellState.PREOPERATIONAL:
            return self._reply(request, Fault.NOT_READY)
        session, outcome = await self._desk.greet(request)
        self._conversation.begin(session, request.sequence)
        self.suspended = None
        self._cycles.end()
        for fault, detail in outcome.faults:
            self.alarms.come(fault, detail)
        if self.state.is_executing:
            await self._machine.fire(CellEvent.ABANDON, "the robot greeted anew")
        if outcome.resume is None:
            return self._reply(request)
        if self.state is CellState.READY:
            await self._machine.fire(CellEvent.OFFER, f"result {outcome.resume.result_id} is still in the gripper")
        return self._reply(request, left=1, offer=outcome.resume)

    async def _bye(self, request: Request) -> Answer:
        await self._desk.void("the robot program ended", session=request.session)
        self._cycles.end()
        if self.state.is_executing:
            await self._machine.fire(CellEvent.ABANDON, "the robot program ended")
        self.suspended = SuspendedCause.ROBOT_ABSENT
        return self._reply(request)

    # A cycle

    async def _trigger(self, request: Request) -> Answer:
        if self.state not in {CellState.READY, CellState.OFFERING}:
            standing = self.alarms.standing
            return self._reply(request, standing[-1].fault if standing else Fault.NOT_READY)
        job = await self._desk.job_for(request)
        if job.state is not JobState.OPEN:
            return self._reply(request, ResultCode.JOB_COMPLETE)
        await self._drop_unfinished(request)
        if self.state is CellState.OFFERING:
            await self._machine.fire(CellEvent.FINISH, "a new picture was asked for")
        blocking = self.alarms.has(*BLOCKING_FAULTS)
        if blocking is not None:
            self.held = HeldCause.OPERATOR
            return self._reply(request, blocking)
        if request.status.gripper_holds_part:
            self.alarms.come(Fault.GRIPPER_NOT_EMPTY, "a part is in the gripper when a picture is asked for")
            return self._reply(request, Fault.GRIPPER_NOT_EMPTY)
        self.alarms.cease(Fault.GRIPPER_NOT_EMPTY)
        self.held = self.suspended = None
        began_s = self._clock()
        cycle = CycleRecord(0, job.job_id, request.session, request.sequence)
        self._cycles.begin(cycle)
        self._conversation.trigger_sequence = request.sequence
        await self._machine.fire(CellEvent.TRIGGER, f"trigger {request.session}/{request.sequence}")
        try:
            answer = await self._look(request, job, cycle)
        except LookError as error:
            self.alarms.come(error.fault, str(error))
            self.held = HeldCause.CAMERA if error.fault in CAMERA_FAULTS else HeldCause.NO_MATCH
            await self._machine.fire(CellEvent.ABANDON, str(error))
            answer = self._reply(request, error.fault)
        cycle.times_ms["total"] = (self._clock() - began_s) * 1000
        cycle.code, cycle.message = answer.code, answer.message
        if answer.left == 0:
            self._cycles.end()
        return answer

    async def _look(self, request: Request, job: Job, cycle: CycleRecord) -> Answer:
        frame = await self._looking.acquire(cycle)
        self.alarms.cease(*CAMERA_FAULTS)
        slots = await self._desk.slots(self.settings.attempts_per_slot)
        cycle.free_slots = slots.free
        if len(slots.laid) == job.slots:
            return await self._verify(request, cycle, frame, slots.laid)
        if not slots.free:
            detail = f"slots {', '.join(map(str, slots.given_up))} failed {self.settings.attempts_per_slot} times"
            raise LookError(Fault.TRIED_TOO_OFTEN, detail)
        await self._machine.fire(CellEvent.LOCATE, f"frame {frame.frame_id}")
        if slots.laid:
            await self._check_laid(job, cycle, frame, slots.laid)
        plan = await self._looking.locate(frame, slots.free, cycle)
        began_s = self._clock()
        written = await self._desk.write_cycle(request, plan.pairs)
        cycle.times_ms["ledger"] = (self._clock() - began_s) * 1000
        cycle.offers = tuple(written)
        if written:
            cycle.cycle_id = written[0].cycle_id
            self.alarms.cease(*_FINDING_FAULTS)
            await self._machine.fire(CellEvent.OFFER, f"{len(written)} results")
            return self._reply(request, left=len(written))
        await self._machine.fire(CellEvent.FINISH, "nothing to offer")
        return self._nothing_left(request, cycle)

    def _nothing_left(self, request: Request, cycle: CycleRecord) -> Answer:
        if cycle.refused:
            fault, detail = cycle.refused[0].fault, cycle.refused[0].detail
            self.held = HeldCause.NO_MATCH
        elif cycle.result is not None and cycle.result.rejected:
            fault, detail = Fault.NO_MATCH, cycle.result.rejected[0].detail
            self.held = HeldCause.NO_MATCH
        else:
            fault, detail = Fault.NOTHING_FOUND, "the pick area is empty"
            self.suspended = SuspendedCause.NOTHING_ON_TABLE
        self.alarms.come(fault, detail)
        return self._reply(request, ResultCode.NOTHING_LEFT, message=entry(fault).robot)

    async def _verify(self, request: Request, cycle: CycleRecord, frame: ImageFrame, laid: tuple[int, ...]) -> Answer:
        cycle.verification = True
        await self._machine.fire(CellEvent.VERIFY, "every slot is filled")
        try:
            placements = await self._looking.measure(frame, laid, cycle)
        except LookError as error:
            placements = ()
            self.alarms.come(Fault.VERIFICATION_IMPOSSIBLE, str(error))
        self._judge(placements)
        await self._desk.complete(placements)
        await self._machine.fire(CellEvent.FINISH, "verified")
        return self._reply(request, ResultCode.JOB_COMPLETE)

    async def _check_laid(self, job: Job, cycle: CycleRecord, frame: ImageFrame, laid: tuple[int, ...]) -> None:
        """Look after what lies already: the picture is there anyway."""
        try:
            placements = await self._looking.measure(frame, laid, cycle)
        except LookError as error:  # the last picture decides; this one was for information
            self._log.warning("laid slabs not measured", detail=str(error))
            return
        self._judge(placements)
        self._emit(Verified(job, placements, final=False))

    def _judge(self, placements: tuple[PlacementRecord, ...]) -> None:
        settings = self.settings
        for item in placements:
            if not item.found:
                self.alarms.come(Fault.PLACEMENT_MISSING, f"slot {item.slot}")
            elif (
                max(abs(item.dx_mm), abs(item.dy_mm)) > settings.tolerance_mm
                or abs(item.da_deg) > settings.tolerance_deg
            ):
                self.alarms.come(
                    Fault.PLACEMENT_OUT_OF_TOLERANCE,
                    f"slot {item.slot}: dx {item.dx_mm:+.2f} mm, dy {item.dy_mm:+.2f} mm, {item.da_deg:+.2f}°;"
                    f" allowed are {settings.tolerance_mm} mm and {settings.tolerance_deg}°",
                )

    # Results

    async def _next(self, request: Request) -> Answer:
        waiting = await self._desk.open_offers()
        if not waiting:
            return self._reply(request)
        offer = next((item for item in waiting if item.state is not _O.PLANNED), waiting[0])
        if offer.state is _O.ACCEPTED:
            return self._refuse(request, Fault.ROBOT_MUST_FINISH)
        if offer.state is _O.PLANNED:
            offer = await self._desk.move(offer, _O.OFFERED, request, "")
        self._emit(Offered(offer))
        return self._reply(request, left=len(waiting), offer=offer)

    async def _acknowledge(self, request: Request) -> Answer:
        offer = await self._desk.find(request.ack_result_id)
        said = request.ack_state
        if offer is None or said is AckState.NONE:
            return self._refuse(request, Fault.ROBOT_ACKNOWLEDGES_UNKNOWN)
        holds = request.status.gripper_holds_part
        if said in _SAID:
            state, reason, fault = _SAID[said], "", None
        else:
            decision = given_up(offer.state, said, holds_part=holds)
            state, reason, fault = decision.state, decision.reason, decision.fault
        if offer.state is not state:
            if offer.state not in _UNDER_WAY or (offer.state, state) in _BACKWARDS:
                return self._refuse(request, Fault.ROBOT_ACKNOWLEDGES_UNKNOWN)
            await self._desk.move(offer, state, request, reason)
            if fault is not None:
                self.alarms.come(fault, f"result {offer.result_id}, slot {offer.slot}: {reason}")
            if said in {AckState.PICK_FAILED, AckState.ABORTED}:
                await self._desk.void("the table may be disturbed", session=request.session)
        waiting = await self._desk.open_offers()
        if not waiting and self.state is CellState.OFFERING:
            self._cycles.end()
            await self._machine.fire(CellEvent.FINISH, "every result is settled")
        return self._reply(request, left=len(waiting))

    async def _drop_unfinished(self, request: Request) -> None:
        """Settle what the robot leaves behind by asking for a new picture."""
        for offer in await self._desk.open_offers():
            if offer.state in HAND_STATES:
                decision = given_up(offer.state, AckState.ABORTED, holds_part=request.status.gripper_holds_part)
                await self._desk.move(offer, decision.state, request, decision.reason)
                if decision.fault is not None:
                    self.alarms.come(decision.fault, f"result {offer.result_id}: {decision.reason}")
        await self._desk.void("a new picture was asked for", session=request.session)


def _to_offer(offer: OfferRecord) -> Offer:
    return Offer(offer.result_id, offer.index, offer.slot, offer.pick, offer.place, offer.score)
