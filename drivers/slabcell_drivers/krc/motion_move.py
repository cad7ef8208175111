"""What is a motion between its plan and its end?  The move itself, and those that an interrupt has put aside."""

from collections import deque
from dataclasses import dataclass, field

from slabcell_drivers.krc.motion import Trajectory
from slabcell_drivers.krc.motion_hold import PathStop
from slabcell_drivers.krc.motion_orders import MoveOrder, TriggerOrder
from slabcell_drivers.robot.arm import Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["HeldMoves", "Move"]


@dataclass(slots=True)
class Move:
    """One planned motion."""

    order: MoveOrder
    trajectory: Trajectory
    tool: Frame
    base: Frame
    approximated: bool
    blend_s: float = 0.0
    elapsed_s: float = 0.0
    triggers: list[tuple[float, TriggerOrder]] = field(default_factory=list[tuple[float, TriggerOrder]])
    stops: list[PathStop] = field(default_factory=list[PathStop])


@dataclass(slots=True)
class HeldMoves:
    """What was interrupted by a motion within an interrupt routine."""

    axes: Axes
    active: Move | None
    fading: Move | None
    queue: deque[Move]
    planned: Axes
