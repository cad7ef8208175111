"""What stands in the ledger?  Jobs, results and placements as values, and the steps that a result may take."""

import math
from dataclasses import dataclass
from enum import StrEnum

from slabcell_drivers.robot.frame import Frame

__all__ = [
    "HAND_STATES",
    "STEPS",
    "TAKEN_STATES",
    "Job",
    "JobState",
    "OfferRecord",
    "OfferState",
    "Pair",
    "PlacementRecord",
]


class OfferState(StrEnum):
    """How far a result got."""

    PLANNED = "planned"  # computed, not yet told to the robot
    OFFERED = "offered"
    ACCEPTED = "accepted"
    GRASPED = "grasped"
    PLACED = "placed"
    FAILED = "failed"
    VOID = "void"
    UNKNOWN = "unknown"  # a person has to look


class JobState(StrEnum):
    """Where a job stands."""

    OPEN = "open"
    COMPLETE = "complete"
    ABANDONED = "abandoned"


_O = OfferState

TAKEN_STATES = frozenset({_O.PLANNED, _O.OFFERED, _O.ACCEPTED, _O.GRASPED, _O.PLACED, _O.UNKNOWN})
"""States in which a slot must not be given to another slab."""

HAND_STATES = frozenset({_O.ACCEPTED, _O.GRASPED})
"""States in which the robot is on its way to a slab or holds it."""

STEPS: dict[OfferState, frozenset[OfferState]] = {
    _O.PLANNED: frozenset({_O.OFFERED, _O.VOID}),
    _O.OFFERED: frozenset({_O.ACCEPTED, _O.GRASPED, _O.PLACED, _O.FAILED, _O.VOID, _O.UNKNOWN}),
    _O.ACCEPTED: frozenset({_O.GRASPED, _O.PLACED, _O.FAILED, _O.VOID, _O.UNKNOWN}),
    _O.GRASPED: frozenset({_O.PLACED, _O.FAILED, _O.UNKNOWN}),
    _O.PLACED: frozenset(),
    _O.FAILED: frozenset(),
    _O.VOID: frozenset(),
    _O.UNKNOWN: frozenset({_O.PLACED, _O.FAILED}),
}
"""Which state may follow which.

Steps forward may be skipped: an acknowledgement that was lost is overtaken by the next one.
"""


@dataclass(frozen=True, slots=True)
class Job:
    """One filling of a template; every place is shifted by the correction."""

    job_id: int
    robot_job: int
    recipe: str
    template_sha256: str
    slots: int
    state: JobState
    correction_mm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Pair:
    """What planning hands to the ledger: where to pick, where to place, and how good the match is."""

    slot: int
    pick: Frame
    place: Frame
    score: float


@dataclass(frozen=True, slots=True)
class OfferRecord:
    """One result as the ledger has it."""

    result_id: int
    job_id: int
    cycle_id: int
    index: int
    slot: int
    state: OfferState
    score: float
    pick: Frame
    place: Frame
    reason: str
    fault: int = 0


@dataclass(frozen=True, slots=True)
class PlacementRecord:
    """How a slab lies in its slot: placed minus nominal, in the assembly frame; NaN where it could not be measured."""

    slot: int
    found: bool
    dx_mm: float
    dy_mm: float
    da_deg: float
    residual_mm: float

    @property
    def is_measured(self) -> bool:
        """Whether the picture tells how the slab lies; one that is not found is not measured either."""
        return self.found and math.isfinite(self.dx_mm + self.dy_mm + self.da_deg)
