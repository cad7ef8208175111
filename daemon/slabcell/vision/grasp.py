"""Where may the suction cup touch a slab?  A point of the slot, as near to the centre of mass as the cup fits.

A slab held beside its centre of mass tilts and turns under the cup; a cup over the edge leaks.  So the cup, with its
margin, must lie on the slab entirely, and of all places where it does the one nearest to the centre of mass is taken.
Where it fits nowhere the slab is refused, and the largest free circle says by how much.

Source of the largest circle: M. Garcia-Castellanos, U. Lombardo, "Poles of inaccessibility", Scottish Geographical
Journal 123(3), 2007 (as in GEOS).
"""

from dataclasses import dataclass

import numpy as np
import shapely
from shapely.ops import nearest_points

from slabcell.geometry import Points, Polygon
from slabcell.recipe import GraspParameters
from slabcell.vision.outline import distance_to_outline

__all__ = ["Grasp", "choose_grasp"]

# The place found is moved inward by this much, so that rounding never leaves the cup over the edge.
SAFETY_MM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """``point`` (2,) mm in the frame of the slot, or None with the reason in ``refusal``.

    ``clearance_mm``: distance from the point to the outline.  ``lever_mm``: distance to the centre of mass.
    """

    point: Points | None
    clearance_mm: float
    lever_mm: float
    refusal: str = ""


def choose_grasp(slot: Polygon, parameters: GraspParameters) -> Grasp:
    """Return where to grasp a slab of this outline."""
    needed = parameters.cup_radius_mm + parameters.margin_mm
    allowed = shapely.buffer(slot.shape, -(needed + SAFETY_MM), quad_segs=32)
    centre = shapely.Point(float(slot.centroid[0]), float(slot.centroid[1]))
    if allowed.is_empty:
        free = float(shapely.maximum_inscribed_circle(slot.shape, tolerance=0.01).length)
        return Grasp(
            None,
            free,
            0.0,
            f"the cup of {parameters.cup_radius_mm:g} mm radius and its margin of {parameters.margin_mm:g} mm need a"
            f" free circle of {needed:.1f} mm radius, the largest on this slab has {free:.1f} mm",
        )
    nearest, _ = nearest_points(allowed, centre)
    # Rounded to a nanometre, and without the sign of a negative zero.
    point: Points = np.array([round(nearest.x, 6), round(nearest.y, 6)], np.float64) + 0.0
    clearance = float(distance_to_outline(point[None, :], slot.vertices)[0])
    return Grasp(point, clearance, float(np.linalg.norm(point - slot.centroid)))
