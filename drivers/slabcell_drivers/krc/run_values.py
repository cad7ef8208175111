"""What does a run of a program tell, and what does the cell around the robot have to offer?"""

from dataclasses import dataclass
from typing import Protocol

from slabcell_drivers.robot.frame import Frame

__all__ = ["CellIo", "RunResult", "TraceEvent"]


class CellIo(Protocol):
    """The cell around the robot, as far as it follows outputs and the tool."""

    def output_changed(self, index: int, value: bool, tcp: Frame) -> None:  # noqa: FBT001  # a bit is a value
        """$OUT[index] has changed; ``tcp`` is the tool centre point in the robot's root."""
        ...

    def moved(self, tcp: Frame) -> None:
        """Take note that the tool has moved there: called at the end of every motion at least."""
        ...


@dataclass(frozen=True, slots=True)
class TraceEvent:
    """One thing that happened; ``kind`` is statement, motion, io, telegram or message."""

    kind: str
    time_s: float
    file: str
    line: int
    text: str


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended, where, and with which message.

    ``status`` is done, halted (HALT), stopped (emergency stop, mode), error, cancelled, reset, deselected, deadline
    or power_lost.
    """

    status: str
    message_number: int
    message: str
    file: str
    line: int
    virtual_time_s: float
    statements: int
