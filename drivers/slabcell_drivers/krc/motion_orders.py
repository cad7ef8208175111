"""What does a program order of the arm?  Motions with their points evaluated, and triggers on their way."""

from collections.abc import Callable
from dataclasses import dataclass

from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.code import Activation
from slabcell_drivers.krc.values import Value

__all__ = ["MoveOrder", "PathOrder", "TriggerOrder"]


@dataclass(frozen=True, slots=True)
class MoveOrder:
    """One motion instruction with its points evaluated."""

    kind: str
    points: tuple[Value, ...]
    angle_deg: float | None = None
    approximation: tuple[str, ...] = ()
    reference: str = ""
    settings: tuple[tuple[str, Place, Value], ...] = ()
    """What stands behind WITH: the name of the variable, the place and the value."""
    file: str = ""
    line: int = 0

    @property
    def sets(self) -> frozenset[str]:
        """The variables that it has settings of its own for."""
        return frozenset(name for name, _, _ in self.settings)

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


@dataclass(frozen=True, slots=True)
class PathOrder:
    """TIME_BLOCK, CONST_VEL or STOP WHEN PATH; ``value`` is a percentage, a time or millimetres along the path."""

    kind: str
    verb: str
    value: float
    on_start: bool
    where: str
    holds: Callable[[], bool] | None = None
    uses_time: bool = False
