"""Which slabs make matching hard?  Random pools of templates: look-alikes, mirror images, symmetric shapes.

All lengths are relative to a nominal size of one: a shape's diameter is about one.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import shapely

__all__ = ["irregular", "irregular_pool", "mirrored", "mixed_pool", "near_duplicate"]

Points = npt.NDArray[np.float64]
Random = np.random.Generator

SMALLEST_WIDTH = 0.12  # of a part of a shape, relative to its size
SMALLEST_EDGE = 0.08
SMALLEST_ANGLE_DEG = 32.0


def irregular(random: Random, *, concave: bool | None = None) -> Points:
    """Return a simple polygon of 4 to 12 corners without slivers; convex, concave or either."""
    for _ in range(2000):
        corners = int(random.integers(4, 13))
        gaps = random.uniform(0.45, 1.0, corners)
        angles = np.cumsum(gaps / gaps.sum()) * 2 * np.pi + random.uniform(0, 2 * np.pi)
        radii = random.uniform(0.45, 1.0, corners) if concave is not False else random.uniform(0.85, 1.0, corners)
        stretch = random.uniform(0.6, 1.0)
        points = np.column_stack([np.cos(angles) * radii, np.sin(angles) * radii * stretch])
        shape = shapely.Polygon(points)
        if concave is False:
            shape = shape.convex_hull
            points = np.asarray(shapely.orient_polygons(shape).exterior.coords)[:-1]
        points = _normal(points)
        bulge = shapely.Polygon(points).area / shapely.Polygon(points).convex_hull.area
        if _sound(points) and not (concave and bulge > 0.93):
            return points
    msg = "no sound irregular polygon was found in 2000 tries"
    raise RuntimeError(msg)


def near_duplicate(random: Random, points: Points, share: float = 0.06) -> Points:
    """Return the shape with one corner moved by a share of its size."""
    for _ in range(200):
        moved = points.copy()
        direction = random.uniform(0, 2 * np.pi)
        moved[random.integers(len(points))] += share * np.array([np.cos(direction), np.sin(direction)])
        difference = shapely.Polygon(points).symmetric_difference(shapely.Polygon(moved))
        if _sound(moved) and difference.area > 0.25 * share * SMALLEST_EDGE:
            return moved
    msg = "no sound near-duplicate was found in 200 tries"
    raise RuntimeError(msg)


def mirrored(points: Points) -> Points:
    """Return the mirror image, counter-clockwise again."""
    return (points * (-1.0, 1.0))[::-1].copy()


def mixed_pool(random: Random) -> list[Points]:
    """Return 16 shapes: irregular, a size family, a mirrored pair, near-duplicates, regular, L T U shapes."""
    family = irregular(random)
    chiral = _chiral(random)
    twin = irregular(random)
    makers: list[Callable[[], Points]] = [
        lambda: irregular(random, concave=False),
        lambda: irregular(random, concave=False),
        lambda: irregular(random, concave=True),
        lambda: irregular(random, concave=True),
        lambda: irregular(random),
    ]
    pool = [make() for make in makers]
    pool += [family, family * 0.93, family * 0.82]
    pool += [chiral, mirrored(chiral)]
    pool += [twin, near_duplicate(random, twin)]
    sides = random.choice([3, 4, 5, 6, 8], 2, replace=False)
    pool += [_regular(int(count)) * random.uniform(0.7, 1.0) for count in sides]
    letters = random.permutation(3)[:2]
    pool += [(_l_shape, _t_shape, _u_shape)[kind](random) for kind in letters]
    return pool


def irregular_pool(random: Random) -> list[Points]:
    """Return 16 irregular shapes, convex and concave."""
    return [irregular(random, concave=index % 2 == 1) for index in range(16)]


def _chiral(random: Random) -> Points:
    """Return an irregular shape that differs clearly from its mirror image, however that is turned."""
    for _ in range(200):
        points = irregular(random)
        shape, image = shapely.Polygon(points), shapely.Polygon(mirrored(points))
        best = min(
            shapely.affinity.rotate(image, angle, origin=image.centroid).symmetric_difference(shape).area
            for angle in range(0, 360, 5)
        )
        if best > 0.06 * shape.area:
            return points
    msg = "no chiral polygon was found in 200 tries"
    raise RuntimeError(msg)


def _regular(sides: int) -> Points:
    angles = np.arange(sides) * 2 * np.pi / sides
    return _normal(np.column_stack([np.cos(angles), np.sin(angles)]))


def _l_shape(random: Random) -> Points:
    a, b, s, t = random.uniform((0.8, 0.5, 0.25, 0.25), (1.0, 0.75, 0.4, 0.4))
    return _normal(np.array([[0, 0], [a, 0], [a, s], [t, s], [t, b], [0, b]]))


def _t_shape(random: Random) -> Points:
    w, h, s, t = random.uniform((0.8, 0.6, 0.2, 0.2), (1.0, 0.9, 0.35, 0.35))
    left, right = (w - t) / 2, (w + t) / 2
    return _normal(
        np.array([[left, 0], [right, 0], [right, h - s], [w, h - s], [w, h], [0, h], [0, h - s], [left, h - s]])
    )


def _u_shape(random: Random) -> Points:
    w, h, s, t = random.uniform((0.8, 0.6, 0.2, 0.2), (1.0, 0.8, 0.3, 0.28))
    return _normal(np.array([[0, 0], [w, 0], [w, h], [w - t, h], [w - t, s], [t, s], [t, h], [0, h]]))


def _normal(points: Points) -> Points:
    """Return the shape counter-clockwise, its centroid at the origin, its diameter one."""
    shape = shapely.orient_polygons(shapely.Polygon(points))
    corners = np.asarray(shape.exterior.coords)[:-1]
    size = max(float(np.linalg.norm(corners - corner, axis=1).max()) for corner in corners)
    return (corners - np.asarray(shape.centroid.coords)[0]) / size


def _sound(points: Points) -> bool:
    """Tell whether a shape could be a slab: simple, no short edge, no sharp corner, no thin neck."""
    shape = shapely.Polygon(points)
    if len(points) < 4 or not shape.is_valid:
        return False
    before, after = np.roll(points, 1, axis=0) - points, np.roll(points, -1, axis=0) - points
    lengths = np.linalg.norm(after, axis=1)
    cosine = np.sum(before * after, axis=1) / (np.roll(lengths, 1) * lengths)
    angles = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    core = shape.buffer(-SMALLEST_WIDTH / 2)
    return bool(
        lengths.min() > SMALLEST_EDGE
        and angles.min() > SMALLEST_ANGLE_DEG
        and core.geom_type == "Polygon"
        and shape.area > 0.25
    )
