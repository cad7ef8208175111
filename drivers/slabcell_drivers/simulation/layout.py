"""Where do the slabs lie at first?  Strewn over the pick area at random, none near another; it always ends.

First each slab, largest first, tries random poses.  Where that does not find a place for all, they are set out in
shelves and shaken: many small random moves, each kept only if every clearance still holds.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import shapely

__all__ = ["LayoutError", "strew"]

Points = npt.NDArray[np.float64]
Pose = tuple[float, float, float]
"""x mm, y mm, angle deg."""

TRIES_A_SLAB = 200
ROUNDS = 4
SHAKES_A_SLAB = 150
SHELF_STEPS_MM = (4.0, 2.0)


class LayoutError(ValueError):
    """The slabs do not fit into the pick area."""


def strew(
    bodies: Sequence[Points], area: shapely.Polygon, clearance_mm: float, random: np.random.Generator
) -> list[Pose]:
    """Return a pose of each body (n, 2) in the area's frame: inside the area, at least ``clearance_mm`` apart.

    Raises LayoutError if they do not even fit laid out in shelves.
    """
    shapes = [shapely.Polygon(body) for body in bodies]
    order = sorted(range(len(bodies)), key=lambda index: -shapes[index].area)
    needed = sum(shape.buffer(0.5 * clearance_mm).area for shape in shapes)
    if needed <= area.buffer(0.5 * clearance_mm).area:
        for _ in range(ROUNDS):
            found = _reject(bodies, order, area, clearance_mm, random)
            if found is not None:
                return found
        for step_mm in SHELF_STEPS_MM:
            shelved = _shelves(bodies, order, area, clearance_mm, step_mm)
            if shelved is not None:
                return _shake(bodies, shelved, area, clearance_mm, random)
    msg = (
        f"{len(bodies)} slabs of {sum(shape.area for shape in shapes):.0f} mm², {clearance_mm:g} mm "
        f"apart, do not fit into the pick area of {area.area:.0f} mm²: make it larger or the clearance smaller"
    )
    raise LayoutError(msg)


def posed(body: Points, pose: Pose) -> shapely.Polygon:
    """Return a body at a pose."""
    angle = np.deg2rad(pose[2])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return shapely.Polygon(body @ turn.T + pose[:2])


def _free(shape: shapely.Polygon, others: list[shapely.Polygon], area: shapely.Polygon, clearance_mm: float) -> bool:
    if not area.contains(shape):
        return False
    return not others or not bool(np.any(shapely.dwithin(shape, others, clearance_mm)))


def _reject(
    bodies: Sequence[Points],
    order: Sequence[int],
    area: shapely.Polygon,
    clearance_mm: float,
    random: np.random.Generator,
) -> list[Pose] | None:
    left, low, right, high = area.bounds
    poses: dict[int, Pose] = {}
    laid: list[shapely.Polygon] = []
    for index in order:
        for _ in range(TRIES_A_SLAB):
            x, y, angle = random.uniform((left, low, -180.0), (right, high, 180.0)).tolist()
            shape = posed(bodies[index], (x, y, angle))
            if _free(shape, laid, area, clearance_mm):
                laid.append(shape)
                poses[index] = (x, y, angle)
                break
        else:
            return None
    return [poses[index] for index in range(len(bodies))]


def _shelves(
    bodies: Sequence[Points], order: Sequence[int], area: shapely.Polygon, clearance_mm: float, step_mm: float
) -> list[Pose] | None:
    """Return poses in rows from the area's lower left, at angle zero, tallest first; None if they do not fit so."""
    left, low, right, high = area.bounds
    gap = clearance_mm * 1.01 + 1e-6
    waiting = sorted(order, key=lambda index: -float(np.ptp(bodies[index][:, 1])))
    poses: dict[int, Pose] = {}
    laid: list[shapely.Polygon] = []
    for index in waiting:
        body = bodies[index]
        corner = body.min(axis=0)
        for y in np.arange(low, high, step_mm):
            for x in np.arange(left, right, step_mm):
                pose = (float(x - corner[0]), float(y - corner[1]), 0.0)
                shape = posed(body, pose)
                if _free(shape, laid, area, gap):
                    laid.append(shape)
                    poses[index] = pose
                    break
            if index in poses:
                break
        else:
            return None
    return [poses[index] for index in range(len(bodies))]


def _shake(
    bodies: Sequence[Points],
    poses: list[Pose],
    area: shapely.Polygon,
    clearance_mm: float,
    random: np.random.Generator,
) -> list[Pose]:
    shapes = [posed(body, pose) for body, pose in zip(bodies, poses, strict=True)]
    reach = 0.25 * float(np.hypot(area.bounds[2] - area.bounds[0], area.bounds[3] - area.bounds[1]))
    for index in map(int, random.integers(0, len(bodies), SHAKES_A_SLAB * len(bodies))):
        size = reach * float(random.uniform(0.02, 1.0)) ** 2
        along, across, turn = (float(value) for value in random.standard_normal(3) * size)
        old = poses[index]
        pose = (old[0] + along, old[1] + across, old[2] + 3.0 * turn)
        shape = posed(bodies[index], pose)
        if _free(shape, shapes[:index] + shapes[index + 1 :], area, clearance_mm):
            shapes[index], poses[index] = shape, pose
    return [(x, y, (angle + 180.0) % 360.0 - 180.0) for x, y, angle in poses]
