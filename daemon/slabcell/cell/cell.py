"""The cell: what does it answer to each request of the robot, and what does it do for it?

Whatever the robot may act on is in the ledger before the answer leaves, and so is every acknowledgement.  It is *not*
responsible for opening devices or for the robot's connection: the service is.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from functools import partial

import structlog

from slabcell.calibration.model import Calibration
from slabcell.catalogue import Fault, entry
from slabcell.cell.afterwards import Afterwards
from slabcell.cell.alarms import Alarms
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cycles import Cycles
from slabcell.cell.desk import JobDesk
from slabcell.cell.events import CycleRecord, Event, StateChanged, Subscriber
from slabcell.cell.execution import Execution
from slabcell.cell.eyes import Eyes
from slabcell.cell.handover import Handover
from slabcell.cell.ledger import Ledger
from slabcell.cell.leisure import Leisure
from slabcell.cell.looking import Looking
from slabcell.cell.outfit import Outfit
from slabcell.cell.preparing import Preparation
from slabcell.cell.records import Job, JobState, PlacementRecord
from slabcell.cell.requests import Requests
from slabcell.cell.serving import Serving
from slabcell.cell.settings import CellSettings
from slabcell.cell.states import CellEvent, CellState, Conditions, HeldCause, StateMachine, SuspendedCause
from slabcell.errors import SlabcellError
from slabcell.recipe import Recipe
from slabcell_drivers.camera.protocol import Camera
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.robot.protocol import Answer, Request

__all__ = ["Cell"]

STOP_PATIENCE_S = 0.5

_AT_LEISURE = frozenset({CellState.INITIALIZED, CellState.READY, CellState.HALTED})
"""States in which nothing is under way.  `initialized` lasts only where there is no calibration."""


class Cell:
    """One cell with one camera and one robot.  `handle` is what a `RobotLink` needs.

    Without a calibration it takes pictures, and waits for one: see `slabcell.cell.preparing`.
    """

    def __init__(
        self,
        camera: Camera,
        calibration: Calibration | None,
        recipe: Recipe,
        *,
        arm: ArmModel,
        settings: CellSettings,
        ledger: Ledger,
        bundles: BundleWriter | None = None,
        eyes: Eyes | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._outfit = Outfit.of(recipe, calibration, settings, arm, eyes=eyes)
        self._afterwards = Afterwards()
        self.alarms = Alarms(self._emit, later=self._afterwards.do, clock=clock)
        self._conditions = Conditions(suspended=SuspendedCause.ROBOT_ABSENT)
        self._machine = StateMachine(
            lambda before, after, cause: self._emit(StateChanged(before, after, cause)), later=self._afterwards.do
        )
        self._preparation = Preparation(self._machine, self.alarms, self._conditions)
        self._desk = JobDesk(ledger, recipe, self._emit)
        self._cycles = Cycles(
            *(ledger, self._outfit.context() if bundles else None, bundles),
            emit=self._emit,
            catch_up=self._afterwards.catch_up,
            failed=lambda detail: self.alarms.come(Fault.BUNDLE_UNWRITABLE, detail),
            kept=lambda: self.alarms.cease(Fault.BUNDLE_UNWRITABLE),
        )
        self._looking = Looking(camera, self._outfit, emit=self._emit, clock=clock)
        self._execution = Execution(
            *(self._machine, self._desk, self._looking, self._cycles),
            alarms=self.alarms,
            conditions=self._conditions,
            settings=settings,
            emit=self._emit,
            clock=clock,
        )
        self._serving = Serving(
            *(self._machine, self._desk, self._execution, self._cycles),
            Handover(self._desk, alarms=self.alarms, emit=self._emit),
            alarms=self.alarms,
            conditions=self._conditions,
        )
        self.leisure = bundles.leisure if bundles is not None else Leisure()
        """When what can be done later may be done."""
        self._requests = Requests(
            *(self._serving, self._desk, self._cycles),
            leisure=self.leisure,
            busy_timeout_s=lambda: self.settings.busy_timeout_s,
            clock=clock,
        )
        self._changing = asyncio.Lock()
        self._subscribers: list[Subscriber] = []
        self._log = structlog.stdlib.get_logger("slabcell.cell")

    @property
    def state(self) -> CellState:
        """Where the cell stands."""
        return self._machine.state

    @property
    def recipe(self) -> Recipe:
        """What is laid."""
        return self._outfit.recipe

    @property
    def settings(self) -> CellSettings:
        """How the cell is set up."""
        return self._outfit.settings

    @property
    def calibration(self) -> Calibration | None:
        """What pixels become millimetres with; None as long as there is none."""
        return self._outfit.calibration

    @property
    def held(self) -> HeldCause | None:
        """Why the cell holds, if it does."""
        return self._conditions.held

    @property
    def suspended(self) -> SuspendedCause | None:
        """Why the cell waits for something outside of it, if it does."""
        return self._conditions.suspended

    @property
    def serving_for_s(self) -> float:
        """How long the present request has been served, in seconds; 0 if there is none."""
        return self._requests.serving_for_s

    @property
    def stepping(self) -> bool:
        """Whether the cell halts after the next slab."""
        return self._serving.stepping

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
    def forgiven_up_to(self) -> int:
        """Failures of results up to this one do not count any more: a person had their slots tried again."""
        return self._desk.forgiven_up_to

    def subscribe(self, subscriber: Subscriber) -> Callable[[], None]:
        """Have ``subscriber`` called with every event from now on, until it raises; return the function that ends it.

        It is called a moment after the event, so that the robot does not wait for it.
        """
        self._afterwards.catch_up()
        self._subscribers.append(subscriber)

        def end() -> None:
            self._afterwards.catch_up()
            if subscriber in self._subscribers:
                self._subscribers.remove(subscriber)

        return end

    def _emit(self, event: Event) -> None:
        self._afterwards.do(partial(self._tell, event))

    def _tell(self, event: Event) -> None:
        for subscriber in tuple(self._subscribers):
            try:
                subscriber(event)
            except Exception:  # noqa: BLE001 - a watcher must not stop the cell
                self._subscribers.remove(subscriber)
                self._log.exception("subscriber failed and is told nothing any more", subscriber=repr(subscriber))

    @asynccontextmanager
    async def _turn(self) -> AsyncGenerator[None]:
        """Have the cell for oneself; who watches knows in the end what came of it."""
        async with self._requests.turn:
            try:
                yield
            finally:
                self._afterwards.catch_up()

    # Life

    async def start(self) -> None:
        """Become ready if there is a calibration, without moving anything.  Raises CalibrationError or LedgerError."""
        if self.calibration is not None:
            self.calibration.require_plane()
        await self._machine.fire(CellEvent.INITIALIZE, "start")
        abandoned = await self._desk.take_up()
        if abandoned is not None:
            self.alarms.come(Fault.RECIPE_CHANGED, abandoned)
        await self._serving.unresolved()
        await self._preparation.finish(self.calibration, self.recipe.name)

    async def stop(self) -> None:
        """Take back what the robot has not begun with, and end every thread; may be called twice.

        A request that waits for a picture is given up soon: what it had not written yet never was.
        """
        await self._requests.end(STOP_PATIENCE_S)
        async with self._turn():
            if self.state is not CellState.PREOPERATIONAL:
                self._cycles.end()
                try:
                    await self._desk.void("the cell was stopped")
                except SlabcellError as error:  # what is not void now is settled when the robot greets again
                    self._log.warning("offers not taken back", error=str(error))
                await self._machine.fire(CellEvent.STOP, "stop")
                self._cycles.settle()
        await self._requests.settled()
        await self._looking.close()
        await self._cycles.close()
        self._afterwards.catch_up()

    # A person

    async def acknowledge(self, fault: Fault, by: str = "a person") -> None:
        """Take a person's word that an alarm is dealt with.

        A lost slab is then found and back on the table, and its slot is empty; a slot that failed too often is tried
        again.  Raises SlabcellError for an alarm that a word cannot clear.
        """
        async with self._turn():
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
        async with self._turn():
            await self._desk.resolve(result_id, placed=placed)
            await self._serving.unresolved()

    async def verify(self) -> tuple[PlacementRecord, ...]:
        """Measure now how the slabs of the job lie; the arm must be out of view, which the caller sees to.

        Raises SlabcellError if the cell is not ready or has no job, and LookError if there is no usable picture.
        """
        async with self._turn():
            if self.state is not CellState.READY or self.job is None:
                what = "has no job" if self.state is CellState.READY else f"is {self.state}"
                msg = f"the cell {what}: a verification needs a job, and a cell that is ready"
                raise SlabcellError(msg, number=Fault.NOT_READY)
            placements = await self._execution.verify(self.job)
            self._cycles.settle()
            return placements

    async def halt(self, cause: str) -> None:
        """Offer nothing any more, until `resume`.  What the robot holds it may still lay down."""
        async with self._turn():
            await self._serving.halt(cause)
            self._cycles.settle()

    async def resume(self, by: str = "a person", *, step: bool = False) -> None:
        """Leave the halted state; with ``step`` for one slab only.  Nothing moves: the robot has to trigger."""
        async with self._turn():
            await self._machine.fire(CellEvent.INITIALIZE, f"resumed by {by}")
            self._serving.stepping = step
            await self._preparation.finish(self.calibration, self.recipe.name)

    async def clear(self, by: str = "a person") -> None:
        """Leave the error state after a person has removed its cause."""
        async with self._turn():
            await self._machine.fire(CellEvent.CLEAR, f"cleared by {by}")
            for alarm in self.alarms.standing:
                if entry(alarm.fault).category in {"ledger", "service"}:
                    self.alarms.settle(alarm.fault, f"cleared by {by}")
            await self._preparation.finish(self.calibration, self.recipe.name)

    async def step(self) -> None:
        """Halt after the slab that is under way or comes next.  Raises SlabcellError where nothing can be offered."""
        async with self._turn():
            if self.state is not CellState.READY and not self.state.is_executing:
                msg = f"the cell is {self.state}: it can go one step when it is halted, ready or in a cycle"
                raise SlabcellError(msg, number=Fault.NOT_READY)
            self._serving.stepping = True

    async def look(self) -> CycleRecord:
        """Take a picture and see what could be laid; nothing is offered, nothing is written, no state changes.

        The robot waits meanwhile: it is the caller's business to ask only when no robot does.  Raises SlabcellError
        while a cycle is on its way, and LookError if there is no usable picture.
        """
        async with self._turn():
            self._require_leisure()
            return await self._execution.look(self.job)

    async def snap(self) -> None:
        """Take a picture for people to look at, as `look` does, but do not look for slabs in it."""
        async with self._turn():
            self._require_leisure()
            await self._execution.snap()

    def _require_leisure(self) -> None:
        if self.state not in _AT_LEISURE:
            msg = f"the cell is {self.state}: a picture is taken on request when it is ready or halted"
            raise SlabcellError(msg, number=Fault.NOT_READY)

    async def abandon_job(self, by: str = "a person") -> Job:
        """Close the open job before it is complete; the next trigger begins a new one.  Raises SlabcellError."""
        async with self._turn():
            job = None if self.state.is_executing else await self._desk.abandon(f"abandoned by {by}")
            if job is None:
                msg = "a cycle is on its way: halt the cell first" if self.state.is_executing else "no job is open"
                raise SlabcellError(msg, number=Fault.NOT_READY)
            await self._serving.unresolved()
            return job

    async def change(
        self,
        *,
        recipe: Recipe | None = None,
        calibration: Calibration | None = None,
        settings: CellSettings | None = None,
    ) -> None:
        """Work with another recipe, calibration or settings from the next trigger on.

        Raises SlabcellError while a cycle is on its way and, for a recipe or a calibration, while a job is open;
        CalibrationError; and ModelError for a model that the recipe names and that cannot be used.
        """
        async with self._changing:  # what one change has not yet written another must not take for granted
            await self._change(recipe, calibration, settings)

    async def _change(
        self, recipe: Recipe | None, calibration: Calibration | None, settings: CellSettings | None
    ) -> None:
        calibration_given = calibration is not None
        recipe, settings = recipe or self.recipe, settings or self.settings
        calibration = calibration or self.calibration
        if calibration is not None:
            calibration.require_plane()
        outfit = await asyncio.to_thread(Outfit.of, recipe, calibration, settings, self._outfit.arm)
        async with self._turn():
            if self.state not in _AT_LEISURE:
                msg = f"the cell is {self.state}: this changes only when it is ready or halted"
                raise SlabcellError(msg, number=Fault.NOT_READY)
            changed = "recipe" if recipe is not self.recipe else "calibration" if calibration_given else ""
            if changed and self.job is not None and self.job.state is JobState.OPEN:
                msg = (
                    f"job {self.job.job_id} is open: a {changed} changes only between jobs; finish or abandon it first"
                )
                raise SlabcellError(msg, number=Fault.NOT_READY)
            if recipe is not self.recipe:
                self._desk.change(recipe)
            self._outfit = outfit
            self._looking.change(outfit)
            self._execution.change(settings)
            self._cycles.change(outfit.context())
            if self.state is CellState.INITIALIZED:
                await self._preparation.finish(calibration, recipe.name)
            else:
                self._preparation.look(calibration)

    def overhear(self, direction: str, telegram: bytes, at_s: float) -> None:
        """Take a telegram as it went over the wire, for the bundles; ``direction`` is received or sent."""
        self._cycles.overhear(direction, telegram, at_s)

    def robot_link(self, *, connected: bool) -> None:
        """Take notice of the robot's connection.  One that ends without a farewell is an alarm until it is back."""
        if connected:
            self.alarms.cease(Fault.ROBOT_ABSENT)
        elif self._conditions.suspended is not SuspendedCause.ROBOT_ABSENT:
            self._conditions.suspended = SuspendedCause.ROBOT_ABSENT
            self.alarms.come(Fault.ROBOT_ABSENT, "the connection ended while the robot program was running")

    async def handle(self, request: Request) -> Answer:
        """Answer one request of the robot: see `slabcell.cell.requests`."""
        return await self._requests.handle(request)

    async def settled(self) -> None:
        """Return when all that the robot has asked until now is done: the ledger holds it, and who watches knows."""
        await self._requests.settled()
        self._afterwards.catch_up()
