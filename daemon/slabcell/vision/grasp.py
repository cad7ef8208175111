"""Where may the suction cups touch a slab?  A point as near to the centre of mass as every cup fits.

A slab held beside its centre of mass tilts and turns under the cups; a cup over the edge leaks.  So every cup, with its
margin, must lie on the slab entirely and in no forbidden zone; of all places where they do, the one nearest to the
centre of mass is taken.  A single cup is round, so the tool's rotation is the template's; several cups are turned until
they fit best.  Where they fit nowhere the slab is refused, and the largest free circle says by how much.

Source of the largest circle: D. Garcia-Castellanos, U. Lombardo, "Poles of inaccessibility", Scottish Geographical
Journal 123(3), 2007 (as in GEOS).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely.affinity import translate
from shapely.ops import nearest_points

from slabcell.geometry import Points, Polygon, RigidTransform2D, normalize_deg
from slabcell.recipe import GraspParameters

__all__ = ["Grasp", "choose_grasp"]

# The place found is moved inward by this much, so that rounding never leaves the cup over the edge.
SAFETY_MM = 1e-3
# Chords of a quarter of a circle.
QUARTER_CHORDS = 32
# Rotations of a gripper of several cups that are tried.
TURN_STEP_DEG = 5.0
# Millimetres of distance from the centre of mass that a larger turn of the tool must save.
SAVING_MM = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Grasp:
    """``point`` (2,) mm in the frame of the template, or None with the reason in ``refusal``.

    ``turn_deg``: direction of the tool's X axis there.  ``clearance_mm``: least distance from a cup's centre to the
    outline or a forbidden zone.  ``lever_mm``: distance of the point from the centre of mass.
    """

    point: Points | None
    turn_deg: float
    clearance_mm: float
    lever_mm: float
    refusal: str = ""


def choose_grasp(slot: Polygon, parameters: GraspParameters, number: int | None = None) -> Grasp:
    """Return where to grasp a slab of this outline; ``number`` is its slot, for the zones that belong to one."""
    needed = parameters.cup_radius_mm + parameters.margin_mm
    free: Any = slot.shape
    for zone in parameters.forbidden:
        if zone.slot is None or zone.slot == number:
            free = free.difference(shapely.Polygon(zone.polygon).buffer(0))
    # Round corners are drawn by chords, which must not come nearer than the circle.
    places: Any = free.buffer(
        -(needed + SAFETY_MM) / math.cos(math.pi / (4 * QUARTER_CHORDS)), quad_segs=QUARTER_CHORDS
    )
    centre = shapely.Point(float(slot.centroid[0]), float(slot.centroid[1]))
    cups = np.array(parameters.cups_mm, np.float64)
    best: tuple[float, float, Points] | None = None
    for turn in _turns(cups):
        allowed = _all_fit(places, RigidTransform2D(turn, 0.0, 0.0).apply(cups))
        if allowed.is_empty:
            continue
        nearest, _ = nearest_points(allowed, centre)
        # Rounded to a nanometre, and without the sign of a negative zero.
        point: Points = np.array([round(nearest.x, 6), round(nearest.y, 6)], np.float64) + 0.0
        lever = float(np.linalg.norm(point - slot.centroid))
        if best is None or lever < best[0] - SAVING_MM:
            best = (lever, turn, point)
    if best is None:
        return Grasp(None, 0.0, 0.0, 0.0, _refusal(free, parameters, needed))
    lever, turn, point = best
    seats = RigidTransform2D(turn, float(point[0]), float(point[1])).apply(cups)
    clearance = min(float(free.boundary.distance(shapely.Point(float(x), float(y)))) for x, y in seats)
    return Grasp(point, turn, clearance, lever)


def _turns(cups: Points) -> list[float]:
    """Return the rotations to try, the smallest first."""
    if len(cups) == 1 and not np.any(cups):
        return [0.0]
    turns = [normalize_deg(step * TURN_STEP_DEG) for step in range(round(360.0 / TURN_STEP_DEG))]
    return sorted(turns, key=lambda turn: (abs(turn), -turn))


def _all_fit(places: Any, cups: Points) -> Any:
    """Return where the tool may stand so that each cup stands in one of the places."""
    allowed = places
    for index, (x, y) in enumerate(cups):
        moved = translate(places, -float(x), -float(y))
        allowed = moved if index == 0 else allowed.intersection(moved)
        if allowed.is_empty:
            break
    return allowed


def _refusal(free: Any, parameters: GraspParameters, needed: float) -> str:
    if free.is_empty:
        return "forbidden zones cover the whole slab"
    pieces = [piece for piece in getattr(free, "geoms", [free]) if piece.area > 0]
    radii: list[Any] = [shapely.maximum_inscribed_circle(piece, tolerance=0.01) for piece in pieces]
    largest = max((float(radius.length) for radius in radii), default=0.0)
    cups = "the cup" if len(parameters.cups_mm) == 1 else f"each of the {len(parameters.cups_mm)} cups"
    text = (
        f"{cups} of {parameters.cup_radius_mm:g} mm radius with its margin of {parameters.margin_mm:g} mm needs a free"
        f" circle of {needed:.1f} mm radius, the largest on this slab has {largest:.1f} mm"
    )
    return text if largest < needed else f"{text}, but the cups do not fit together in any rotation"
