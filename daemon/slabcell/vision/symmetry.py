"""Which rotations of a slot look alike?  The order of its rotational symmetry, within a tolerance."""

import numpy as np

from slabcell.geometry import Points, Polygon, RigidTransform2D
from slabcell.vision.outline import distance_to_outline

__all__ = ["MAX_ORDER", "symmetry_order"]

# A shape with more rotations than this is a disc as far as edges can tell.
MAX_ORDER = 12


def symmetry_order(slot: Polygon, tolerance_mm: float) -> int:
    """Return the greatest n for which a turn by 360°/n about the centroid moves no corner off the outline.

    1 means that one rotation alone fits.
    """
    corners = slot.vertices - slot.centroid
    farthest = corners[np.argmax(np.sum(corners**2, axis=1))][None, :]
    for order in range(MAX_ORDER, 1, -1):
        # Cheap first: one corner, turned, must lie on the outline.
        if all(_stays(corners, points, order, tolerance_mm) for points in (farthest, corners)):
            return order
    return 1


def _stays(outline: Points, points: Points, order: int, tolerance_mm: float) -> bool:
    turned = RigidTransform2D(360.0 / order, 0.0, 0.0).apply(points)
    return float(distance_to_outline(turned, outline).max()) <= tolerance_mm
