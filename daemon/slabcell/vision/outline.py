"""How are outlines sampled and compared in general?  Polygon moments, offsetting and resampling by arc length."""

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points

__all__ = ["area_and_centroid", "distance_to_outline", "offset_outward", "polar_inertia", "resample"]


def area_and_centroid(polygon: Points) -> tuple[float, Points]:
    """Return the signed area (counter-clockwise is positive) and the centroid of a closed polygon (n, 2)."""
    origin = polygon[0]
    x, y = (polygon - origin).T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    cross = x * next_y - next_x * y
    area = 0.5 * float(cross.sum())
    if abs(area) < 1e-12:
        return 0.0, polygon.mean(axis=0)
    centre = np.array([np.sum((x + next_x) * cross), np.sum((y + next_y) * cross)]) / (6.0 * area)
    return area, centre + origin


def polar_inertia(polygon: Points) -> float:
    """Return the polar second moment of area about the centroid over the squared area: 1/(2π) for a disc, more else."""
    area, centre = area_and_centroid(polygon)
    if area == 0.0:
        return 0.0
    x, y = (polygon - centre).T
    next_x, next_y = np.roll(x, -1), np.roll(y, -1)
    cross = x * next_y - next_x * y
    second = np.sum(cross * (x * x + x * next_x + next_x * next_x + y * y + y * next_y + next_y * next_y)) / 12.0
    return abs(float(second)) / area**2


def offset_outward(polygon: Points, distance: float) -> Points:
    """Return a counter-clockwise polygon whose edges have moved outward by ``distance``; mitres are cut at twice it."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    keep = lengths > 1e-9
    polygon, edges, lengths = polygon[keep], edges[keep], lengths[keep]
    if len(polygon) < 3:
        return polygon
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / lengths[:, None]
    before = np.roll(normals, 1, axis=0)
    bisector = normals + before
    # |bisector|²/2 = 1 + cos of the turn; the mitre's length is 1/that along the bisector.
    scale = np.maximum(1.0 + np.sum(normals * before, axis=1), 0.5)
    return polygon + distance * bisector / scale[:, None]


def resample(polygon: Points, count: int) -> Points:
    """Return ``count`` points at equal distances along a closed polygon, beginning at its first vertex."""
    closed = np.vstack([polygon, polygon[:1]])
    lengths = np.hypot(*np.diff(closed, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, float(along[-1]), count, endpoint=False)
    result = np.empty((count, 2))
    for axis in (0, 1):
        result[:, axis] = np.interp(at, along, closed[:, axis])
    return result


def distance_to_outline(points: Points, polygon: Points) -> npt.NDArray[np.float64]:
    """Return the distance of each point (n, 2) from the nearest point of a closed polygon's outline."""
    start = polygon[None, :, :]
    edge = np.roll(polygon, -1, axis=0)[None, :, :] - start
    relative = points[:, None, :] - start
    length = np.maximum(np.sum(edge**2, axis=2), 1e-18)
    share = np.clip(np.sum(relative * edge, axis=2) / length, 0.0, 1.0)
    away = relative - share[:, :, None] * edge
    return np.sqrt(np.sum(away**2, axis=2).min(axis=1))
