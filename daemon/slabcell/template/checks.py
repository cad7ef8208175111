"""Can these polygons be laid?  What is wrong with one outline, and with all of them together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import shapely

from slabcell.geometry import Points, Polygon
from slabcell.template.model import PointMm, Problem

__all__ = ["MAX_POINTS", "MAX_SLOTS", "check_polygon", "check_together", "outlines_of"]

MAX_SLOTS: Final = 5_000
MAX_POINTS: Final = 2_000

# Slabs are between a fingernail and a lorry: outside of this the unit is probably wrong.
SMALLEST_EXTENT_MM: Final = 5.0
LARGEST_EXTENT_MM: Final = 50_000.0

# Coordinates written with two decimals let neighbours overlap by slivers of this width; it is not an overlap.
SLIVER_MM: Final = 0.05

# More findings than a person reads help nobody, and each may carry an outline.
MAX_OVERLAPS: Final = 500


def check_polygon(points: Points, place: Callable[[int], str]) -> Polygon | list[Problem]:
    """Return the polygon of an outline, (n, 2) mm, or what is wrong with it; ``place`` says where a point is written.

    The problems of one outline show it whole, and the point where it goes wrong.
    """
    outline = (tuple((float(x), float(y)) for x, y in points),)

    def problem(kind: str, index: int, **values: str | float) -> Problem:
        return Problem(kind, place(index), values, at_mm=_point(points[index]), outlines_mm=outline)

    if len(points) < 3:
        return [problem("too_few_points", len(points) - 1, count=len(points))]
    if len(points) > MAX_POINTS:
        return [Problem("too_many_points", place(MAX_POINTS), {"count": len(points), "most": MAX_POINTS})]
    found = list(_duplicates(points, place, problem))
    if found:
        return found
    if not shapely.LinearRing(points).is_simple:
        return [problem("crossing", _crossing(points))]
    polygon = Polygon.from_points(points)
    longest = max(polygon.bounds[2] - polygon.bounds[0], polygon.bounds[3] - polygon.bounds[1])
    if polygon.area_mm2 <= 1e-6 * longest * longest:
        return [problem("zero_area", 0)]
    return polygon


def _duplicates(points: Points, place: Callable[[int], str], problem: Callable[..., Problem]) -> Iterator[Problem]:
    seen: dict[tuple[float, float], int] = {}
    for index, point in enumerate(points):
        key = (round(float(point[0]), 6), round(float(point[1]), 6))
        if key in seen:
            first = seen[key]
            kind = "closing_point" if first == 0 and index == len(points) - 1 else "duplicate_point"
            where = place(first).rpartition(": ")[2]
            yield problem(kind, index, x=float(point[0]), y=float(point[1]), first=first + 1, first_place=where)
        seen.setdefault(key, index)


def _crossing(points: Points) -> int:
    """Return the first point whose edge meets an edge that is not its neighbour."""
    count = len(points)
    edges = [shapely.LineString([points[i], points[(i + 1) % count]]) for i in range(count)]
    tree = shapely.STRtree(edges)
    for index, edge in enumerate(edges):
        for other in sorted(int(hit) for hit in tree.query(edge, predicate="intersects")):
            if other > index:
                apart = min(other - index, count - other + index)
                overlap = shapely.intersection(edge, edges[other])
                if apart > 1 or overlap.length > 0:
                    return other
    return 0


def check_together(slots: Sequence[Polygon], place: Callable[[int], str], other: Callable[[int], str]) -> list[Problem]:
    """Return what is wrong with all slots together.

    ``place`` says where a slot is written, as a problem begins with it; ``other`` the same in the middle of a sentence.
    """
    low = np.min([polygon.bounds[:2] for polygon in slots], axis=0)
    high = np.max([polygon.bounds[2:] for polygon in slots], axis=0)
    extent = float(np.max(high - low))
    if extent < SMALLEST_EXTENT_MM:
        return [Problem("in_metres", "", {"extent_mm": extent, "least_mm": SMALLEST_EXTENT_MM})]
    if extent > LARGEST_EXTENT_MM:
        return [Problem("in_micrometres", "", {"extent_mm": extent, "most_mm": LARGEST_EXTENT_MM})]
    found: list[Problem] = []
    for index, polygon in enumerate(slots):
        size = max(polygon.bounds[2] - polygon.bounds[0], polygon.bounds[3] - polygon.bounds[1])
        if size < 1e-3 * extent:
            values = {"size_mm": size, "extent_mm": extent}
            found.append(Problem("tiny_slot", place(index), values, (index,), _point(polygon.centroid)))
    return found + _overlaps(slots, place, other)


def _overlaps(slots: Sequence[Polygon], place: Callable[[int], str], other: Callable[[int], str]) -> list[Problem]:
    shapes = [polygon.shape for polygon in slots]
    tree = shapely.STRtree(shapes)
    found: list[Problem] = []
    for index, shape in enumerate(shapes):
        for second in sorted(int(hit) for hit in tree.query(shape, predicate="intersects")):
            if second >= index:
                continue
            common = shapely.intersection(shape, shapes[second])
            if shapely.buffer(common, -SLIVER_MM).is_empty:
                continue
            middle = common.representative_point()
            values = {"slot": index, "other": second, "other_place": other(second), "area_mm2": float(common.area)}
            found.append(
                Problem(
                    *("overlap", place(index), values, (second, index), (float(middle.x), float(middle.y))),
                    outlines_of(common),
                )
            )
            if len(found) == MAX_OVERLAPS:
                return found
    return found


def outlines_of(shape: Any) -> tuple[tuple[PointMm, ...], ...]:
    """Return the outer rings of everything in a geometry that has an area."""
    pieces = [piece for piece in getattr(shape, "geoms", [shape]) if piece.area > 0]
    return tuple(tuple((float(x), float(y)) for x, y in piece.exterior.coords[:-1]) for piece in pieces)


def _point(point: Points) -> PointMm:
    return float(point[0]), float(point[1])
