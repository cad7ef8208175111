"""What does the cell tell those who watch it?  Events, as values, in the order in which things happen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

from slabcell.catalogue import Fault
from slabcell.cell.planning import Refusal
from slabcell.cell.records import Job, OfferRecord, PlacementRecord
from slabcell.cell.states import CellState
from slabcell.vision.result import LocateResult
from slabcell_drivers.camera.protocol import ImageFrame
from slabcell_drivers.robot.protocol import Answer, Request

__all__ = [
    "AlarmCame",
    "AlarmChanged",
    "AlarmWent",
    "CycleEnded",
    "CycleKept",
    "CycleRecord",
    "Event",
    "FrameTaken",
    "JobBegan",
    "JobEnded",
    "Offered",
    "PartsLocated",
    "ResultMoved",
    "StageEnded",
    "StateChanged",
    "Subscriber",
    "Verified",
]


@dataclass(slots=True, eq=False)
class CycleRecord:
    """One trigger and what came of it.  ``times_ms`` holds the stages in their order, and ``total``.

    ``transcript`` holds requests and answers, ``telegrams`` what went over the wire for them, where a link says so.
    ``number`` is given by who keeps a history, 0 where nobody does.
    """

    cycle_id: int
    job_id: int
    session: int
    trigger_sequence: int
    verification: bool = False
    code: int = 0
    message: str = ""
    times_ms: dict[str, float] = field(default_factory=dict[str, float])
    frame: ImageFrame | None = None
    result: LocateResult | None = None
    refused: tuple[Refusal, ...] = ()
    offers: tuple[OfferRecord, ...] = ()
    placements: tuple[PlacementRecord, ...] = ()
    free_slots: tuple[int, ...] = ()
    laid_slots: tuple[int, ...] = ()
    correction_mm: tuple[float, float] = (0.0, 0.0)
    transcript: list[tuple[Request, Answer]] = field(default_factory=list[tuple[Request, Answer]])
    telegrams: list[dict[str, object]] = field(default_factory=list[dict[str, object]])
    number: int = 0
    frame_id: int | None = None
    heard_from: int = 0
    began_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))


@dataclass(frozen=True, slots=True)
class StateChanged:
    """The cell went from one state to another."""

    before: CellState
    after: CellState
    cause: str


@dataclass(frozen=True, slots=True)
class JobBegan:
    """A template begins to be filled."""

    job: Job


@dataclass(frozen=True, slots=True)
class JobEnded:
    """A job is complete or abandoned."""

    job: Job


@dataclass(frozen=True, slots=True)
class FrameTaken:
    """A complete picture is there."""

    frame: ImageFrame


@dataclass(frozen=True, slots=True)
class PartsLocated:
    """The vision has finished."""

    result: LocateResult


@dataclass(frozen=True, slots=True)
class StageEnded:
    """A stage of the cycle has finished."""

    stage: str
    duration_ms: float


@dataclass(frozen=True, slots=True)
class Offered:
    """A result is about to be told to the robot; it is in the ledger."""

    offer: OfferRecord


@dataclass(frozen=True, slots=True)
class ResultMoved:
    """A result has a new state; it is in the ledger."""

    offer: OfferRecord


@dataclass(frozen=True, slots=True)
class Verified:
    """Laid slabs were measured: all of them if ``final``."""

    job: Job
    placements: tuple[PlacementRecord, ...]
    final: bool


@dataclass(frozen=True, slots=True)
class CycleEnded:
    """Nothing of a cycle is left to do."""

    cycle: CycleRecord


@dataclass(frozen=True, slots=True)
class CycleKept:
    """A cycle that ended is in its bundle; ``file`` is the bundle's name."""

    cycle: CycleRecord
    file: str


@dataclass(frozen=True, slots=True)
class AlarmCame:
    """An alarm came."""

    fault: Fault
    detail: str


@dataclass(frozen=True, slots=True)
class AlarmWent:
    """An alarm went, and why."""

    fault: Fault
    why: str = ""


@dataclass(frozen=True, slots=True)
class AlarmChanged:
    """A person acknowledged, shelved or unshelved an alarm, which stands on."""

    fault: Fault


Event = (
    StateChanged
    | JobBegan
    | JobEnded
    | FrameTaken
    | PartsLocated
    | StageEnded
    | Offered
    | ResultMoved
    | Verified
    | CycleEnded
    | CycleKept
    | AlarmCame
    | AlarmChanged
    | AlarmWent
)

Subscriber = Callable[[Event], None]
"""Takes one event, in the event loop.  It must return at once; one that raises is logged and dropped."""
