"""What may stand between camera and table?  A hand, or the robot's own arm: bodies in the view that are no slabs."""

import numpy as np
import numpy.typing as npt

from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation.slab import Slab

__all__ = ["arm_in_view", "hand_in_view"]

Points = npt.NDArray[np.float64]

HAND = np.array(
    [[-42, -260], [42, -260], [44, -40], [62, -8], [80, 22], [66, 34], [44, 12], [42, 60], [27, 62], [24, 30], [20, 86],
     [5, 88], [2, 34], [-4, 78], [-18, 76], [-18, 28], [-26, 58], [-39, 54], [-42, -40]],
    np.float64,
)  # fmt: skip
"""A forearm and a hand with spread fingers, in mm; the fingers point along Y."""


def hand_in_view(x_mm: float, y_mm: float, a_deg: float, *, height_mm: float = 60.0, tone: float = 0.6) -> Slab:
    """Return a hand whose palm is over a point of the root frame; ``tone`` is its albedo relative to the slabs."""
    return Slab(-1, "hand", HAND, 40.0, Frame(x_mm, y_mm, height_mm, a_deg), tone=tone, grain=11)


def arm_in_view(
    shoulder: tuple[float, float], tool: tuple[float, float], *, height_mm: float = 150.0
) -> tuple[Slab, ...]:
    """Return a robot's forearm and wrist between two points of the root frame, seen from above."""
    start, end = np.array(shoulder), np.array(tool)
    along = end - start
    length = float(np.linalg.norm(along))
    angle = float(np.rad2deg(np.arctan2(along[1], along[0])))
    half = 45.0
    beam = np.array([[0.0, -half], [length, -0.7 * half], [length, 0.7 * half], [0.0, half]])
    turn = np.linspace(0, 2 * np.pi, 33)[:-1]
    wrist = np.column_stack([np.cos(turn), np.sin(turn)]) * 42.0
    return (
        Slab(-2, "forearm", beam, 80.0, Frame(start[0], start[1], height_mm + 60.0, angle), tone=1.15, grain=12),
        Slab(-3, "wrist", wrist, 60.0, Frame(end[0], end[1], height_mm), tone=0.9, grain=13),
    )
