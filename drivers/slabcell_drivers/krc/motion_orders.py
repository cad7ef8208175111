"""What does a program order of the arm?  Motions with their points evaluated, and triggers on their way."""

from dataclasses import dataclass

from slabcell_drivers.krc.code import Activation
from slabcell_drivers.krc.values import Value

__all__ = ["MoveOrder", "TriggerOrder"]


@dataclass(frozen=True, slots=True)
class MoveOrder:
    """One motion instruction with its points evaluated."""

    kind: str
    points: tuple[Value, ...]
    angle_deg: float | None = None
    approximation: tuple[str, ...] = ()
    reference: str = ""
    settings: frozenset[str] = frozenset()
    file: str = ""
    line: int = 0

    @classmethod
    def returning(cls) -> "MoveOrder":
        """Return the order for the way back to an interrupted path."""
        return cls("PTP", ())


@dataclass(frozen=True, slots=True)
class TriggerOrder:
    """One TRIGGER; ``position`` is 0 or 1 for DISTANCE, millimetres for PATH."""

    kind: str
    position: float
    on_start: bool
    delay_s: float
    priority: int
    activation: Activation
    label: list[int]
