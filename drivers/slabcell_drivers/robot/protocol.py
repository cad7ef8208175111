"""What does a robot say to the cell, and what does the cell answer?  The `RobotLink` protocol and its values.

The robot asks, the cell answers: one answer to each request, in lock-step.  A link (EKI, Modbus) carries requests and
answers and knows nothing of what they mean.  It is *not* responsible for exactly-once behaviour: that is the cell's,
which recognises a repeated request by its session and sequence number.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Protocol

from slabcell_drivers.robot.frame import Frame

__all__ = [
    "AckState",
    "Answer",
    "Handler",
    "LinkState",
    "Offer",
    "Request",
    "RequestType",
    "ResultCode",
    "RobotLink",
    "RobotStatus",
]


class RequestType(IntEnum):
    """What the robot wants; the numbers travel on the wire."""

    HELLO = 1
    TRIGGER = 2
    NEXT = 3
    ACK = 4
    HEARTBEAT = 5
    BYE = 6


class AckState(IntEnum):
    """How far the robot got with a result; the numbers travel on the wire."""

    NONE = 0
    ACCEPTED = 1
    GRASPED = 2
    PLACED = 3
    PICK_FAILED = 4
    UNREACHABLE = 5
    ABORTED = 6


class ResultCode(IntEnum):
    """The code of an answer below 1000; from 1000 on it is a number of the error catalogue."""

    OK = 0
    JOB_COMPLETE = 1  # every slot is filled
    NOTHING_LEFT = 2  # slots are free, but nothing on the table fits them
    BAD_REQUEST = 3  # out of sequence, unknown result, wrong version
    BUSY = 4


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """What the robot says of itself in every request."""

    mode: int = 0  # 0 unknown, 1 T1, 2 T2, 3 AUT, 4 EXT
    tool: int = 0
    base: int = 0
    gripper_holds_part: bool = False
    error: int = 0


@dataclass(frozen=True, slots=True)
class Request:
    """One request of the robot.

    ``sequence`` counts up within a session; the same number again is the same request again.  ``tcp`` is the pose of
    the tool centre point in the robot's root frame.  ``ack_result_id`` and ``ack_state`` say, in HELLO and ACK, which
    result the robot last acted on and how far it got.
    """

    type: RequestType
    session: int
    sequence: int
    job_id: int = 0
    model: int = 0
    tcp: Frame = field(default_factory=Frame)
    axes_deg: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    ack_result_id: int = 0
    ack_state: AckState = AckState.NONE
    status: RobotStatus = field(default_factory=RobotStatus)


@dataclass(frozen=True, slots=True)
class Offer:
    """One result: where to pick a part (in the pick base) and where to place it (in the place base).

    Both are poses of the same point of the part, on its upper face, for a tool whose Z axis points down (B 0, C 180).
    """

    result_id: int
    index: int
    slot: int
    pick: Frame
    place: Frame
    score: float
    grip: int = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """The cell's answer to one request.

    ``code`` is a `ResultCode` or a number of the error catalogue; ``left`` counts the results that are still to be
    fetched, the one in ``offer`` included; ``trigger_sequence`` is the sequence number of the trigger they come from;
    ``message`` is at most 80 characters of ASCII, for the SmartPAD.
    """

    session: int
    sequence: int
    acknowledges: int
    code: int = ResultCode.OK
    left: int = 0
    trigger_sequence: int = 0
    offer: Offer | None = None
    message: str = ""


class LinkState(StrEnum):
    """Where a link stands."""

    CLOSED = "closed"
    LISTENING = "listening"
    CONNECTED = "connected"


Handler = Callable[[Request], Awaitable[Answer]]
"""Answers one request.  It must not raise: what goes wrong in the cell is an answer with a code."""


class RobotLink(Protocol):
    """Carries the requests of one robot to the cell and the cell's answers back."""

    @property
    def state(self) -> LinkState:
        """Where the link stands now."""
        ...

    async def start(self, handler: Handler) -> None:
        """Begin to serve the robot; returns once the link listens.  Raises OSError if its address is taken."""
        ...

    async def stop(self) -> None:
        """Close the connection and stop serving; no task, socket or thread is left behind.  May be called twice."""
        ...
