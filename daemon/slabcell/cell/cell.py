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
from dataclasses import replace

import structlog

from slabcell.calibration.file import from_document as calibration_from_document
from slabcell.calibration.file import to_document as calibration_to_document
from slabcell.calibration.model import Calibration
from slabcell.catalogue import Fault, entry
from slabcell.cell.alarms import Alarms
from slabcell.cell.bundle import BundleContext
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.conversation import Conversation
from slabcell.cell.cycles import Cycles
from slabcell.cell.desk import JobDesk
from slabcell.cell.events import CycleRecord, Event, StateChanged, Subscriber
from slabcell.cell.execution import Execution
from slabcell.cell.eyes import Eyes, HouseEyes
from slabcell.cell.handover import Handover
from slabcell.cell.ledger import Ledger
from slabcell.cell.looking import Looking
from slabcell.cell.planning import Planner
from slabcell.cell.records import Job, JobState, PlacementRecord
from slabcell.cell.reply import Reply, refusal, to_answer
from slabcell.cell.settings import CellSettings
from slabcell.cell.states import CellEvent, CellState, Conditions, HeldCause, StateMachine, SuspendedCause
from slabcell.errors import SlabcellError
from slabcell.recipe import Recipe
from slabcell_drivers.camera.protocol import Camera
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.robot.protocol import AckState, Answer, Request, RequestType, ResultCode

__all__ = ["Cell"]

NEEDS_EYES = frozenset({Fault.PART_LOST, Fault.PLACEMENT_UNKNOWN})
"""Alarms of results that are unknown: nothing is picked until a person has looked."""

_UNDER_WAY = frozenset({AckState.NONE, AckState.ACCEPTED, AckState.GRASPED})
"""What the robot says of a slab that it is not done with."""


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
        # What is computed with is what a bundle holds, to the last bit: the way arrays lie in memory changes rounding.
        calibration = calibration_from_document(calibration_to_document(calibration), "the calibration")
        self.recipe = recipe
        self.settings = settings
        self.alarms = Alarms(self._emit, clock=clock)
        self._conditions = Conditions(suspended=SuspendedCause.ROBOT_ABSENT)
        self._calibration = calibration
        self._machine = StateMachine(lambda before, after, cause: self._emit(StateChanged(before, after, cause)))
        self._desk = JobDesk(ledger, recipe, self._emit)
        self._cycles = Cycles(
            *(ledger, BundleContext(recipe, calibration, settings, arm) if bundles else None, bundles),
            emit=self._emit,
            failed=lambda detail: self.alarms.come(Fault.BUNDLE_UNWRITABLE, detail),
        )
        self._looking = Looking(
            camera,
            calibration,
            eyes=eyes or HouseEyes(calibration, recipe),
            planner=Planner(recipe, settings, arm),
            settings=settings,
            emit=self._emit,
            clock=clock,
        )
        self._execution = Execution(
            *(self._machine, self._desk, self._looking, self._cycles),
            alarms=self.alarms,
            conditions=self._conditions,
            settings=settings,
            emit=self._emit,
            clock=clock,
        )
        self._handover = Handover(self._desk, alarms=self.alarms, emit=self._emit)
        self._conversation = Conversation()
        self._turn = asyncio.Lock()
        self._stepping = False
        self._tasks: set[asyncio.Task[Answer]] = set()
        self._subscribers: list[Subscriber] = []
        self._log = structlog.stdlib.get_logger("slabcell.cell")

    @property
    def state(self) -> CellState:
        """Where the cell stands."""
        return self._machine.state

    @property
    def held(self) -> HeldCause | None:
        """Why the cell holds, if it does."""
        return self._conditions.held

    @property
    def suspended(self) -> SuspendedCause | None:
        """Why the cell waits for something outside of it, if it does."""
        return self._conditions.suspended

    @property
    def stepping(self) -> bool:
        """Whether the cell halts after the next slab."""
        return self._stepping

    @property
    def job(self) -> Job | None:
        """The job that is open, or was just finished."""
        return self._desk.job

    @property
    def cycles(self) -> deque[CycleRecord]:
        """Records of the last cycles, the present one included."""
        return self._cycles.records

    @property
    def present_cycle(self) -> CycleRecord | None:
        """The cycle that is on its way, if one is."""
        return self._cycles.present

    @property
    def calibration(self) -> Calibration:
        """What pixels become millimetres with."""
        return self._calibration

    @property
    def forgiven_up_to(self) -> int:
        """Failures of results up to this one do not count any more: a person had their slots tried again."""
        return self._desk.forgiven_up_to

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
        await self._unresolved()
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

    async def _unresolved(self) -> Fault | None:
        """Raise the alarms of what a person has to look at; return one of them, or None if nothing is open."""
        faults: list[Fault] = []
        for offer in await self._desk.unknown():
            faults.append(Fault(offer.fault) if offer.fault else Fault.PLACEMENT_UNKNOWN)
            self.alarms.come(faults[-1], f"result {offer.result_id}, slot {offer.slot}: {offer.reason}")
        for fault in NEEDS_EYES - set(faults):
            self.alarms.settle(fault, "every result is resolved")
        return faults[-1] if faults else None

    # A person

    async def acknowledge(self, fault: Fault, by: str = "a person") -> None:
        """Take a person's word that an alarm is dealt with.

        A lost slab is then found and back on the table, and its slot is empty; a slot that failed too often is tried
        again.  Raises SlabcellError for an alarm that a word cannot clear.
        """
        async with self._turn:
            if fault is Fault.PLACEMENT_UNKNOWN:
                ids = ", ".join(str(o.result_id) for o in await self._desk.unknown() if o.fault != Fault.PART_LOST)
                msg = f"alarm {int(fault)} goes when results {ids} are resolved: say for each whether it is placed"
                raise SlabcellError(msg, number=fault)
            if fault is Fault.PART_LOST:
                for offer in await self._desk.unknown():
                    if offer.fault == Fault.PART_LOST:
                        await self._desk.resolve(offer.result_id, placed=False)
            if fault is Fault.TRIED_TOO_OFTEN:
                self._desk.forgive()
            self.alarms.acknowledge(fault, by)

    async def resolve(self, result_id: int, *, placed: bool) -> None:
        """Take a person's word for a result that is unknown.  Raises LedgerError if it is settled already."""
        async with self._turn:
            await self._desk.resolve(result_id, placed=placed)
            await self._unresolved()

    async def verify(self) -> tuple[PlacementRecord, ...]:
        """Measure now how the slabs of the job lie; the arm must be out of view, which the caller sees to.

        Raises SlabcellError if the cell is not ready or has no job, and LookError if there is no usable picture.
        """
        async with self._turn:
            if self.state is not CellState.READY or self.job is None:
                what = "has no job" if self.state is CellState.READY else f"is {self.state}"
                msg = f"the cell {what}: a verification needs a job, and a cell that is ready"
                raise SlabcellError(msg, number=Fault.NOT_READY)
            placements = await self._execution.verify(self.job)
            self._cycles.settle()
            return placements

    async def halt(self, cause: str) -> None:
        """Offer nothing any more, until `resume`.  What the robot holds it may still lay down."""
        async with self._turn:
            await self._halt(cause)
            self._cycles.settle()

    async def _halt(self, cause: str) -> None:
        await self._desk.void(cause)
        self._cycles.end()
        await self._machine.fire(CellEvent.HALT, cause)
        self._stepping = False

    async def resume(self, by: str = "a person", *, step: bool = False) -> None:
        """Leave the halted state; with ``step`` for one slab only.  Nothing moves: the robot has to trigger."""
        async with self._turn:
            await self._machine.fire(CellEvent.INITIALIZE, f"resumed by {by}")
            self._stepping = step
            await self._machine.fire(CellEvent.PREPARE, f"recipe {self.recipe.name}")

    async def clear(self, by: str = "a person") -> None:
        """Leave the error state after a person has removed its cause."""
        async with self._turn:
            await self._machine.fire(CellEvent.CLEAR, f"cleared by {by}")
            for alarm in self.alarms.standing:
                if entry(alarm.fault).category in {"ledger", "service"}:
                    self.alarms.settle(alarm.fault, f"cleared by {by}")
            await self._machine.fire(CellEvent.PREPARE, f"recipe {self.recipe.name}")

    async def step(self) -> None:
        """Halt after the slab that is under way or comes next.  Raises SlabcellError where nothing can be offered."""
        async with self._turn:
            if self.state is not CellState.READY and not self.state.is_executing:
                msg = f"the cell is {self.state}: it can go one step when it is halted, ready or in a cycle"
                raise SlabcellError(msg, number=Fault.NOT_READY)
            self._stepping = True

    def robot_link(self, *, connected: bool) -> None:
        """Take notice of the robot's connection.  One that ends without a farewell is an alarm until it is back."""
        if connected:
            self.alarms.cease(Fault.ROBOT_ABSENT)
        elif self._conditions.suspended is not SuspendedCause.ROBOT_ABSENT:
            self._conditions.suspended = SuspendedCause.ROBOT_ABSENT
            self.alarms.come(Fault.ROBOT_ABSENT, "the connection ended while the robot program was running")

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
            return self._to_answer(Reply(ResultCode.BUSY, message="Cell is busy. Ask again."), request)
        try:
            known = self._conversation.recall(request)
            if known is not None:
                self._log.info("request repeated", sequence=request.sequence, type=request.type.name)
                return known
            fault = self._conversation.refuse(request)
            if fault is not None:
                self._log.warning("request refused", number=int(fault), type=request.type.name)
                return self._to_answer(refusal(fault), request)
            before = self._cycles.present
            with structlog.contextvars.bound_contextvars(**self._about(request)):
                answer = self._to_answer(await self._reply(request), request)
            self._cycles.settle(request, answer, before=before)
            self._conversation.remember(request, answer)
            return answer
        finally:
            self._turn.release()

    def _about(self, request: Request) -> dict[str, int]:
        """Return what every line that is logged while a request is served is about."""
        job, cycle, result = self.job, self._cycles.present, request.ack_result_id
        about = {"job": job.job_id if job else 0, "cycle": cycle.cycle_id if cycle else 0, "result": result}
        return {name: number for name, number in about.items() if number}

    async def _reply(self, request: Request) -> Reply:
        try:
            match request.type:
                case RequestType.HELLO:
                    return await self._hello(request)
                case RequestType.TRIGGER:
                    return await self._trigger(request)
                case RequestType.NEXT:
                    return await self._handover.next(request)
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
        self.alarms.come(fault, detail)
        if self.state not in {CellState.ERROR, CellState.PREOPERATIONAL}:
            self._cycles.end()
            await self._machine.fire(CellEvent.FAULT, detail)
        return Reply(fault)

    def _to_answer(self, reply: Reply, request: Request) -> Answer:
        known = self._conversation
        return to_answer(reply, request, session=known.session, trigger_sequence=known.trigger_sequence)

    # Greeting and leaving

    async def _hello(self, request: Request) -> Reply:
        if self.state is CellState.PREOPERATIONAL:
            return Reply(Fault.NOT_READY)
        session, outcome = await self._desk.greet(request)
        self._conversation.begin(session, request.sequence)
        self._conditions.suspended = None
        self._cycles.end()
        for fault, detail in outcome.faults:
            self.alarms.come(fault, detail)
        if self.state.is_executing:
            await self._machine.fire(CellEvent.ABANDON, "the robot greeted anew")
        if outcome.resume is None:
            return Reply()
        if self.state is CellState.READY:
            await self._machine.fire(CellEvent.OFFER, f"result {outcome.resume.result_id} is still in the gripper")
        return Reply(left=1, offer=outcome.resume)

    async def _bye(self, request: Request) -> Reply:
        await self._desk.void("the robot program ended", session=request.session)
        self._cycles.end()
        if self.state.is_executing:
            await self._machine.fire(CellEvent.ABANDON, "the robot program ended")
        self._conditions.suspended = SuspendedCause.ROBOT_ABSENT
        return Reply()

    # A cycle

    async def _trigger(self, request: Request) -> Reply:
        if self.state not in {CellState.READY, CellState.OFFERING}:
            standing = self.alarms.standing
            return Reply(standing[-1].fault if standing else Fault.NOT_READY)
        job = await self._desk.job_for(request)
        if job is not None and job.state is not JobState.OPEN:
            return Reply(ResultCode.JOB_COMPLETE)
        await self._handover.drop_unfinished(request)
        if self.state is CellState.OFFERING:
            await self._machine.fire(CellEvent.FINISH, "a new picture was asked for")
        blocking = await self._unresolved()
        if blocking is not None:
            self._conditions.held = HeldCause.OPERATOR
            return Reply(blocking)
        if request.status.gripper_holds_part:
            self.alarms.come(Fault.GRIPPER_NOT_EMPTY, "a part is in the gripper when a picture is asked for")
            return Reply(Fault.GRIPPER_NOT_EMPTY)
        self.alarms.cease(Fault.GRIPPER_NOT_EMPTY)
        self._conversation.trigger_sequence = request.sequence
        return await self._execution.run(request, job)

    async def _acknowledge(self, request: Request) -> Reply:
        reply = await self._handover.acknowledge(request)
        settled = reply.code == ResultCode.OK and request.ack_state not in _UNDER_WAY
        if settled and self._stepping and self.state in {CellState.READY, CellState.OFFERING}:
            await self._halt("one slab is done: step")
            return replace(reply, left=0)
        if reply.left == 0 and self.state is CellState.OFFERING and not await self._desk.open_offers():
            self._cycles.end()
            await self._machine.fire(CellEvent.FINISH, "every result is settled")
        return reply
