"""What does the cell do with a gripper that hangs on its own I/O?  `GripperGuard`: stands between link and cell.

The robot does not feel the part, the cell does: what the input says goes into each request.  While the I/O does not
answer, or the interlock is open, nothing new is offered; what is in hand may still be laid down.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

from slabcell.catalogue import Fault, entry
from slabcell.cell.alarms import Alarms
from slabcell_drivers.robot import Answer, Handler, Request, RequestType

__all__ = ["GripperGuard", "GripperInputs"]

OFFERS = frozenset({RequestType.TRIGGER, RequestType.NEXT})
REMEMBERED = 64


class GripperInputs(Protocol):
    """What the gripper's I/O says."""

    part_present: bool
    interlock_closed: bool
    answers: bool

    def subscribe(self, changed: Callable[[], None]) -> None:
        """Have ``changed`` called after each change."""
        ...


class GripperGuard:
    """Hands requests on, with what the gripper feels.  A request that is repeated is the same to the last bit."""

    def __init__(self, gripper: GripperInputs, alarms: Alarms, handler: Handler) -> None:
        self._gripper, self._alarms, self._handler = gripper, alarms, handler
        self._felt: dict[Request, bool] = {}
        gripper.subscribe(self._look)
        self._look()

    async def handle(self, request: Request) -> Answer:
        """Answer one request: what a `RobotLink` needs."""
        fault = self._fault()
        if fault is not None and request.type in OFFERS:
            sequence = request.sequence
            return Answer(request.session, sequence, sequence, int(fault), message=entry(fault).robot)
        felt = self._felt.setdefault(request, self._gripper.part_present)
        while len(self._felt) > REMEMBERED:
            self._felt.pop(next(iter(self._felt)))
        status = dataclasses.replace(request.status, gripper_holds_part=felt)
        return await self._handler(dataclasses.replace(request, status=status))

    def _fault(self) -> Fault | None:
        if not self._gripper.answers:
            return Fault.GRIPPER_IO_LOST
        return None if self._gripper.interlock_closed else Fault.INTERLOCK_OPEN

    def _look(self) -> None:
        now = self._fault()
        for fault, words in (
            (Fault.GRIPPER_IO_LOST, "the I/O coupler does not answer"),
            (Fault.INTERLOCK_OPEN, "the interlock input is off"),
        ):
            if fault is now:
                self._alarms.come(fault, words)
            else:
                self._alarms.cease(fault)
