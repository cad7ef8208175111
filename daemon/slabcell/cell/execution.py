"""What happens between a trigger and its answer?  Picture, vision, plan and ledger; or the verification."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import structlog

from slabcell.catalogue import Fault, entry
from slabcell.cell.alarms import Alarms
from slabcell.cell.cycles import Cycles
from slabcell.cell.desk import JobDesk
from slabcell.cell.events import CycleRecord, Event, Verified
from slabcell.cell.looking import CAMERA_FAULTS, LookError, Looking
from slabcell.cell.records import Job, PlacementRecord
from slabcell.cell.reply import Reply
from slabcell.cell.settings import CellSettings
from slabcell.cell.states import CellEvent, Conditions, HeldCause, StateMachine, SuspendedCause
from slabcell_drivers.camera.protocol import ImageFrame
from slabcell_drivers.robot.protocol import Request, ResultCode

__all__ = ["Execution"]

_FINDING_FAULTS = (
    Fault.NO_MATCH,
    Fault.NOTHING_FOUND,
    Fault.IMAGE_UNUSABLE,
    Fault.VISION_SLOW,
    Fault.UNREACHABLE,
    Fault.OUTSIDE_WORKSPACE,
    Fault.COLLISION,
)
"""Alarms that end when something can be offered."""

MOST_NAMED = 12
"""Slots that an alarm names; the report of the job has them all."""

_HELD = {Fault.ASSEMBLY_NOT_EMPTY: HeldCause.OPERATOR, Fault.TRIED_TOO_OFTEN: HeldCause.OPERATOR}


class Execution:
    """Runs one trigger at a time.  The state is `ready` before and after, or `offering` after."""

    def __init__(
        self,
        machine: StateMachine,
        desk: JobDesk,
        looking: Looking,
        cycles: Cycles,
        *,
        alarms: Alarms,
        conditions: Conditions,
        settings: CellSettings,
        emit: Callable[[Event], None],
        clock: Callable[[], float],
    ) -> None:
        self._machine = machine
        self._desk = desk
        self._looking = looking
        self._cycles = cycles
        self._alarms = alarms
        self._conditions = conditions
        self._settings = settings
        self._emit = emit
        self._clock = clock
        self._log = structlog.stdlib.get_logger("slabcell.cell")

    def change(self, settings: CellSettings) -> None:
        """Go by other settings from the next trigger on."""
        self._settings = settings

    async def snap(self) -> None:
        """Take a picture for people to look at; the vision is not asked.  Raises `LookError`."""
        await self._looking.acquire(CycleRecord(0, 0, 0, 0))

    async def look(self, job: Job | None) -> CycleRecord:
        """Take a picture and see what could be laid, because a person wants to know.  Nothing is offered or written.

        Returns a record that is no cycle of the cell.  Raises `LookError` and LedgerError.
        """
        began_s = self._clock()
        cycle = CycleRecord(0, job.job_id if job else 0, 0, 0)
        frame = await self._looking.acquire(cycle)
        slots = await self._desk.slots(self._settings.attempts_per_slot)
        cycle.free_slots, cycle.laid_slots = slots.free, slots.laid
        await self._looking.locate(frame, slots, cycle)
        cycle.times_ms["total"] = (self._clock() - began_s) * 1000
        return cycle

    async def run(self, request: Request, job: Job | None, say: Callable[[Reply], None]) -> Reply:
        """Take a picture and do what it allows; without a job one begins.  May raise LedgerError.

        ``say`` is told how many results there are while they are written: the robot cannot act on a number.
        """
        began_s = self._clock()
        self._conditions.held = self._conditions.suspended = None
        cycle = CycleRecord(0, job.job_id if job else 0, request.session, request.sequence)
        self._cycles.begin(cycle)
        await self._machine.fire(CellEvent.ACQUIRE, f"trigger {request.session}/{request.sequence}")
        try:
            reply = await self._look(request, job, cycle, say)
        except LookError as error:
            self._alarms.come(error.fault, str(error))
            self._conditions.held = _HELD.get(
                error.fault, HeldCause.CAMERA if error.fault in CAMERA_FAULTS else HeldCause.NO_MATCH
            )
            await self._machine.fire(CellEvent.ABANDON, str(error))
            reply = Reply(error.fault)
        cycle.times_ms["total"] = (self._clock() - began_s) * 1000
        cycle.code, cycle.message = int(reply.code), reply.message
        if reply.left == 0:
            self._cycles.end()
        return reply

    async def verify(self, job: Job) -> tuple[PlacementRecord, ...]:
        """Take a picture and measure what lies, because a person wants to know.  Raises `LookError` and LedgerError."""
        cycle = CycleRecord(0, job.job_id, 0, 0, verification=True)
        self._cycles.begin(cycle)
        await self._machine.fire(CellEvent.ACQUIRE, "a person asks for a verification")
        try:
            frame = await self._looking.acquire(cycle)
            await self._machine.fire(CellEvent.VERIFY, "a person asks for it")
            slots = await self._desk.slots(self._settings.attempts_per_slot)
            placements = await self._looking.measure(frame, slots.laid, cycle)
        except LookError as error:
            self._alarms.come(error.fault, str(error))
            await self._machine.fire(CellEvent.ABANDON, str(error))
            cycle.code = int(error.fault)
            self._cycles.end()
            raise
        self._judge(placements, final=len(placements) == job.slots)
        await self._desk.record(placements)
        self._emit(Verified(job, placements, final=False))
        await self._machine.fire(CellEvent.FINISH, "verified")
        self._cycles.end()
        return placements

    async def _look(self, request: Request, job: Job | None, cycle: CycleRecord, say: Callable[[Reply], None]) -> Reply:
        frame = await self._looking.acquire(cycle)
        self._alarms.cease(*CAMERA_FAULTS)
        if job is None:
            occupied = await self._occupied(frame, cycle)
            if occupied is not None:
                return occupied
            settings = self._settings
            limit_mm = settings.tolerance_mm if settings.correct_systematic else 0.0
            job = await self._desk.draft(request, correct_up_to_mm=limit_mm)
        slots = await self._desk.slots(self._settings.attempts_per_slot)
        cycle.free_slots, cycle.laid_slots = slots.free, slots.laid
        if len(slots.laid) == job.slots:
            return await self._verify(cycle, frame, slots.laid)
        if not slots.free:
            detail = f"slots {', '.join(map(str, slots.given_up))} failed {self._settings.attempts_per_slot} times"
            raise LookError(Fault.TRIED_TOO_OFTEN, detail)
        if slots.laid:
            await self._check_laid(job, cycle, frame, slots.laid)
        cycle.correction_mm = job.correction_mm
        locating = self._looking.locate(frame, slots, cycle)
        await self._machine.fire(CellEvent.LOCATE, f"frame {frame.frame_id}")  # told and logged meanwhile
        plan = await locating
        began_s = self._clock()
        if plan.count:
            say(Reply(left=plan.count))
            await asyncio.sleep(0)  # it is sent now: the ledger's thread would take the interpreter
        written = await self._desk.write_cycle(request, job, lambda: plan.pairs)
        cycle.job_id = self._desk.job.job_id if self._desk.job else 0
        cycle.times_ms["ledger"] = (self._clock() - began_s) * 1000
        structlog.contextvars.bind_contextvars(job=cycle.job_id)
        cycle.offers = tuple(written)
        if not written:
            await self._machine.fire(CellEvent.FINISH, "nothing to offer")
            return self._nothing_left(cycle)
        cycle.cycle_id = written[0].cycle_id
        structlog.contextvars.bind_contextvars(cycle=cycle.cycle_id)
        self._alarms.cease(*_FINDING_FAULTS)
        await self._machine.fire(CellEvent.OFFER, f"{len(written)} results")
        return Reply(left=len(written))

    async def _occupied(self, frame: ImageFrame, cycle: CycleRecord) -> Reply | None:
        """Return what to say if slabs lie where a new job shall be laid.

        The finished job lies there until somebody takes it out.  That its robot did not hear that it is finished,
        because the link broke just then, must not have it laid again, on top of itself.
        """
        if not self._settings.check_assembly_is_empty:
            return None
        slots = range(self._desk.slot_count)
        lying = [item.slot for item in await self._looking.measure(frame, slots, cycle) if item.found]
        cycle.placements = ()  # what lies there is not of this cycle
        if not lying:
            self._alarms.cease(Fault.ASSEMBLY_NOT_EMPTY)
            return None
        finished = self._desk.still_lies() if len(lying) == self._desk.slot_count else None
        if finished is not None:
            cycle.job_id = finished.job_id
            await self._machine.fire(CellEvent.ABANDON, "the finished job lies there still")
            return Reply(ResultCode.JOB_COMPLETE)
        raise LookError(Fault.ASSEMBLY_NOT_EMPTY, f"something lies in slots {', '.join(map(str, lying))}")

    def _nothing_left(self, cycle: CycleRecord) -> Reply:
        if cycle.refused:
            fault, detail = cycle.refused[0].fault, cycle.refused[0].detail
            self._conditions.held = HeldCause.NO_MATCH
        elif cycle.result is not None and cycle.result.rejected:
            fault, detail = Fault.NO_MATCH, cycle.result.rejected[0].detail
            self._conditions.held = HeldCause.NO_MATCH
        else:
            fault, detail = Fault.NOTHING_FOUND, "the pick area is empty"
            self._conditions.suspended = SuspendedCause.NOTHING_ON_TABLE
        self._alarms.come(fault, detail)
        return Reply(ResultCode.NOTHING_LEFT, message=entry(fault).robot)

    async def _verify(self, cycle: CycleRecord, frame: ImageFrame, laid: tuple[int, ...]) -> Reply:
        cycle.verification = True
        await self._machine.fire(CellEvent.VERIFY, "every slot is filled")
        try:
            placements = await self._looking.measure(frame, laid, cycle)
        except LookError as error:
            placements = ()
            self._alarms.come(Fault.VERIFICATION_IMPOSSIBLE, str(error))
        self._judge(placements, final=True)
        await self._desk.complete(placements)
        await self._machine.fire(CellEvent.FINISH, "verified")
        return Reply(ResultCode.JOB_COMPLETE)

    async def _check_laid(self, job: Job, cycle: CycleRecord, frame: ImageFrame, laid: tuple[int, ...]) -> None:
        """Look after what lies already: the picture is there anyway."""
        try:
            placements = await self._looking.measure(frame, laid, cycle)
        except LookError as error:  # the last picture decides; this one was for information
            self._log.warning("laid slabs not measured", detail=str(error))
            return
        self._judge(placements, final=False)
        self._emit(Verified(job, placements, final=False))

    def _judge(self, placements: tuple[PlacementRecord, ...], *, final: bool) -> None:
        """Raise what a person has to know of laid slabs; every slot is named.

        One that cannot be measured may well be held by slabs that are still to come: only a ``final`` look says so.
        """
        if missing := [item.slot for item in placements if not item.found]:
            self._alarms.come(Fault.PLACEMENT_MISSING, f"slot {_listed(missing)}")
        if final and (open_ := [item.slot for item in placements if item.found and not item.is_measured]):
            self._alarms.come(
                Fault.VERIFICATION_IMPOSSIBLE,
                f"slot {_listed(open_)}: edges and joints in the picture do not tell how it lies",
            )
        off = sorted((item for item in placements if self._excess(item) > 1.0), key=self._excess, reverse=True)
        if not off:
            return
        worst, limit_mm, limit_deg = off[0], self._settings.tolerance_mm, self._settings.tolerance_deg
        if others := [item.slot for item in off[1:]]:
            self._alarms.come(
                Fault.PLACEMENT_OUT_OF_TOLERANCE,
                f"slot {worst.slot}: dx {worst.dx_mm:+.2f} mm, dy {worst.dy_mm:+.2f} mm, {worst.da_deg:+.2f}°;"
                f" allowed are {limit_mm} mm and {limit_deg}°; out of tolerance too: slot {_listed(others)}",
            )
        else:
            self._alarms.come(
                Fault.PLACEMENT_OUT_OF_TOLERANCE,
                f"slot {worst.slot}: dx {worst.dx_mm:+.2f} mm, dy {worst.dy_mm:+.2f} mm, {worst.da_deg:+.2f}°;"
                f" allowed are {limit_mm} mm and {limit_deg}°",
            )

    def _excess(self, item: PlacementRecord) -> float:
        """Return the largest deviation as a share of what is allowed; 0 for what was not measured."""
        if not item.is_measured:
            return 0.0
        shift_mm, limit_mm = max(abs(item.dx_mm), abs(item.dy_mm)), self._settings.tolerance_mm
        return max(shift_mm / limit_mm, abs(item.da_deg) / self._settings.tolerance_deg)


def _listed(slots: list[int]) -> str:
    """Return slots as people read them; of very many the first ones."""
    shown = ", ".join(map(str, slots[:MOST_NAMED]))
    return f"{shown} and {len(slots) - MOST_NAMED} more" if len(slots) > MOST_NAMED else shown
