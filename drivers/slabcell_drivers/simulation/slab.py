"""What is a slab in the simulated cell?  A body with a level upper face, and where it is."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.robot.frame import Frame

__all__ = ["Slab"]

Points = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Slab:
    """One slab: ``body`` is its outline in its own frame, shape (n, 2) in mm, counter-clockwise.

    ``frame`` is the slab's frame in the robot's root, at its lower face: z_mm is the height it lies at.  ``nominal`` is
    the shape it was meant to have, in the same frame; it differs from ``body`` where a slab was cut with a kerf or is
    broken.  ``tone`` is its albedo relative to the others, ``grain`` chooses its surface texture.
    """

    number: int
    name: str
    body: Points
    thickness_mm: float
    frame: Frame
    nominal: Points = field(default_factory=lambda: np.zeros((0, 2)))
    tone: float = 1.0
    grain: int = 0

    @property
    def outline(self) -> Points:
        """The body's corners in the root frame, shape (n, 2); a carried slab is seen as level."""
        return _turned(self.body, self.frame)

    @property
    def shape(self) -> shapely.Polygon:
        """The body in the root frame."""
        return shapely.Polygon(self.outline)

    @property
    def bottom_mm(self) -> float:
        """Height of the lower face."""
        return self.frame.z_mm

    @property
    def top_mm(self) -> float:
        """Height of the upper face."""
        return self.frame.z_mm + self.thickness_mm


def _turned(points: Points, frame: Frame) -> Points:
    angle = np.deg2rad(frame.a_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return points @ turn.T + (frame.x_mm, frame.y_mm)
