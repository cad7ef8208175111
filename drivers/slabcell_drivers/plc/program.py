"""What does the robot program behind a PLC do?  The job of `krl/SlabCell.src`, step by step, without KRL.

What the robot is about to do goes into its memory and to the cell before the robot does it.  After a lost link it
greets with what it did last and what its gripper feels, and the cell says how to go on.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Protocol

from slabcell_drivers.plc.handshake import LinkLostError
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import (
    AckState,
    Answer,
    Offer,
    Request,
    RequestType,
    ResultCode,
    RobotStatus,
)

__all__ = ["JobEnd", "JobProgram", "RobotBody", "RobotMemory", "Timeouts"]

COMPLETE = "Job complete: every slot is filled"
STALE = "2002 Result refused by the robot: it is an old one."
LOST = "1605 Slab lost after grasping. Find it, then acknowledge."
NO_CELL = "2001 Cell PC does not answer. Check cable, IP and service."
BUSY_TRIES = 10
MODE_EXT = 4

Ask = Callable[[Request, float], Awaitable[Answer]]


class RobotBody(Protocol):
    """Arm and gripper.  Poses are of the tool centre point, in the base of the table (pick) or of the assembly."""

    @property
    def tcp(self) -> Frame:
        """Where the tool centre point is, in the robot's root frame."""
        ...

    def reaches(self, pick: Frame, place: Frame) -> bool:
        """Whether both poses, and the points above them, can be reached."""
        ...

    async def to_photo(self) -> None:
        """Move out of the camera's view."""
        ...

    async def to_pick(self, pick: Frame) -> None:
        """Move from anywhere down to a part."""
        ...

    async def to_place(self, place: Frame) -> None:
        """Move from above the table down into a slot, if the part is still held above it."""
        ...

    async def up(self) -> None:
        """Move straight up."""
        ...

    async def grip(self, *, on: bool) -> None:
        """Turn the suction on or off, and wait for its effect as long as is usual."""
        ...

    async def holds(self) -> bool:
        """Whether the gripper feels a part."""
        ...


@dataclass(slots=True)
class RobotMemory:
    """What survives a restart of the robot: as ``VT.dat`` does."""

    result_id: int = 0
    state: AckState = AckState.NONE
    sequence: int = 0

    def mark(self, result_id: int, state: AckState) -> None:
        """Write how far the robot got; never the new number with the old state."""
        if self.result_id != result_id:
            self.state, self.result_id = AckState.NONE, result_id
        self.state = state


@dataclass(frozen=True, slots=True)
class Timeouts:
    """How long the program waits, in seconds."""

    answer_s: float = 10.0
    trigger_s: float = 60.0
    busy_s: float = 1.0


@dataclass(frozen=True, slots=True)
class JobEnd:
    """How a run ended: ``done`` with its last message, or ``halted`` with the message that a person has to read."""

    status: str
    message: str
    requests: int


class _Halt(Exception):  # noqa: N818 - KRL's word for it
    """The program stops with a message; START goes on."""


@dataclass(slots=True)
class JobProgram:
    """One robot program.  ``run`` may be called again after it has halted: START was pressed."""

    ask: Ask
    body: RobotBody
    memory: RobotMemory = field(default_factory=RobotMemory)
    timeouts: Timeouts = field(default_factory=Timeouts)
    messages: list[str] = field(default_factory=list[str])
    link_tries: int = 10
    _session: int = 0
    _ready: bool = False
    _requests: int = 0
    _trigger_sequence: int = 0

    async def run(self) -> JobEnd:
        """Lay slabs until the cell says that the job is complete, or nothing is left, or a person is needed."""
        tries = 0
        while True:
            try:
                message = await self._cycle()
                tries = 0
            except OSError:  # LinkLostError, or a gripper behind the link that did not answer
                self._ready, message = False, ""
                tries += 1
                if tries >= self.link_tries:
                    return self._ended("halted", NO_CELL)
            except _Halt as halt:
                self._ready = False
                return self._ended("halted", str(halt))
            if message:
                await self.body.to_photo()
                await self._bye()
                return self._ended("done", message)

    def _ended(self, status: str, message: str) -> JobEnd:
        self.messages.append(message)
        return JobEnd(status, message, self._requests)

    async def _cycle(self) -> str:
        """One picture and all its results; returns the message that ends the job, or nothing."""
        if not self._ready:
            await self._finish_held(await self._hello())
        await self.body.to_photo()
        answer = await self._request(RequestType.TRIGGER, self.timeouts.trigger_s)
        if answer.code == ResultCode.JOB_COMPLETE:
            return COMPLETE
        if answer.code == ResultCode.NOTHING_LEFT:
            return answer.message or "1503 No slab on the table fits a free slot."
        self._require_ok(answer)
        left = answer.left
        while left > 0:
            left = await self._lay_next()
        return ""

    async def _lay_next(self) -> int:
        answer = await self._request(RequestType.NEXT, self.timeouts.answer_s)
        self._require_ok(answer)
        offer = answer.offer
        if offer is None:
            return 0
        in_hand = offer.result_id == self.memory.result_id and self.memory.state in (
            AckState.ACCEPTED,
            AckState.GRASPED,
        )
        fresh = offer.result_id > self.memory.result_id and answer.trigger_sequence == self._trigger_sequence
        if not in_hand and not fresh:
            raise _Halt(STALE)
        return await self._lay(offer)

    async def _lay(self, offer: Offer) -> int:
        if not self.body.reaches(offer.pick, offer.place):
            return await self._acknowledge(offer.result_id, AckState.UNREACHABLE)
        await self._acknowledge(offer.result_id, AckState.ACCEPTED)
        await self.body.to_pick(offer.pick)
        await self.body.grip(on=True)
        if await self.body.holds():
            self.memory.mark(offer.result_id, AckState.GRASPED)
        await self.body.up()
        if not await self.body.holds():
            await self.body.grip(on=False)
            return await self._acknowledge(offer.result_id, AckState.PICK_FAILED)
        await self._acknowledge(offer.result_id, AckState.GRASPED)
        return await self._lay_held(offer)

    async def _lay_held(self, offer: Offer) -> int:
        await self.body.to_place(offer.place)
        if not await self.body.holds():
            self.messages.append(LOST)
            await self.body.grip(on=False)
            return await self._acknowledge(offer.result_id, AckState.ABORTED)
        await self.body.grip(on=False)
        self.memory.mark(offer.result_id, AckState.PLACED)
        await self.body.up()
        return await self._acknowledge(offer.result_id, AckState.PLACED)

    async def _finish_held(self, answer: Answer) -> None:
        """Lay down what the gripper still holds, if the cell says where; a person takes off anything else."""
        if answer.left > 0:
            if answer.offer is None:
                answer = await self._request(RequestType.NEXT, self.timeouts.answer_s)
                self._require_ok(answer)
            offer = answer.offer
            if offer is not None:
                if offer.result_id == self.memory.result_id and await self.body.holds():
                    self.memory.mark(offer.result_id, AckState.GRASPED)
                    await self._lay_held(offer)
                else:
                    await self._acknowledge(offer.result_id, AckState.ABORTED)
        if await self.body.holds():
            self.messages.append("2005 Hold the slab, press START, and take it away.")
        await self.body.grip(on=False)

    # ------------------------------------------------------------------------------------------------------- requests

    async def _hello(self) -> Answer:
        self._session = 0
        answer = await self._request(RequestType.HELLO, self.timeouts.answer_s)
        if answer.code == ResultCode.BAD_REQUEST and answer.sequence > self.memory.sequence:
            self.memory.sequence = answer.sequence  # ours was lost: count on from the cell's
            answer = await self._request(RequestType.HELLO, self.timeouts.answer_s)
        self._require_ok(answer)
        self._session, self._ready = answer.session, True
        return answer

    async def _bye(self) -> None:
        try:
            await self._request(RequestType.BYE, self.timeouts.answer_s)
        except OSError as error:
            self.messages.append(str(error))  # the job is over; the cell notices by itself
        self._ready = False

    async def _acknowledge(self, result_id: int, state: AckState) -> int:
        self.memory.mark(result_id, state)
        answer = await self._request(RequestType.ACK, self.timeouts.answer_s)
        self._require_ok(answer)
        return answer.left

    async def _request(self, type_: RequestType, timeout_s: float) -> Answer:
        """Ask; a busy cell is asked again, as a new request."""
        for _ in range(BUSY_TRIES):
            self.memory.sequence += 1
            if type_ is RequestType.TRIGGER:
                self._trigger_sequence = self.memory.sequence
            self._requests += 1
            answer = await self.ask(
                Request(
                    type_,
                    self._session,
                    self.memory.sequence,
                    tcp=self.body.tcp,
                    ack_result_id=self.memory.result_id,
                    ack_state=self.memory.state,
                    status=RobotStatus(mode=MODE_EXT, tool=1, gripper_holds_part=await self.body.holds()),
                ),
                timeout_s,
            )
            if answer.code != ResultCode.BUSY:
                return answer
            await asyncio.sleep(self.timeouts.busy_s)
        raise LinkLostError(f"{type_.name}: the cell is busy, asked {BUSY_TRIES} times")

    def _require_ok(self, answer: Answer) -> None:
        if answer.code != ResultCode.OK:
            raise _Halt(answer.message or f"code {answer.code}")
