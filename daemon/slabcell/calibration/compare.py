"""How far apart are two calibrations of one camera?  Where each says that the same pixels lie on the table."""

from dataclasses import dataclass

import numpy as np

from slabcell.calibration.model import Calibration
from slabcell.geometry import Points

__all__ = ["Distance", "displacements", "distance"]

STEPS = 9


@dataclass(frozen=True, slots=True)
class Distance:
    """By how much points of the table are moved from one calibration to the other, over the picture, in mm."""

    mean_mm: float
    worst_mm: float


def distance(before: Calibration, after: Calibration) -> Distance | None:
    """Return how far apart they are on the work plane; None where one has no plane, or the pictures differ in size."""
    moved = displacements(before, after)
    if moved is None:
        return None
    apart = np.hypot(*moved[:, 2:].T)
    apart = apart[np.isfinite(apart)]
    return Distance(float(apart.mean()), float(apart.max())) if len(apart) else None


def displacements(before: Calibration, after: Calibration) -> Points | None:
    """Return pixels all over the picture and how their points on the work plane moved: u, v, x and y in mm, (n, 4).

    None where one has no plane, or the pictures differ in size.
    """
    size = (before.camera.width, before.camera.height)
    if before.plane is None or after.plane is None or size != (after.camera.width, after.camera.height):
        return None
    # The rim is left out: no corner of a board was ever seen there.
    u, v = np.meshgrid(*(np.linspace(0.1, 0.9, STEPS) * side for side in size))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    return np.column_stack([pixels, after.table_from_image(pixels) - before.table_from_image(pixels)])
