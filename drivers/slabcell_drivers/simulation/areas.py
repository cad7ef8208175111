"""How do plane areas combine?  The few operations of Shapely that are used here, with full types."""

from collections.abc import Iterable, Sequence
from typing import Any, cast

import shapely
from shapely.geometry.base import BaseGeometry

__all__ = ["Area", "common", "minus", "pairs_within", "union"]

Area = BaseGeometry
"""Any plane area: a polygon, several, or nothing."""


def union(areas: Iterable[Area]) -> Area:
    """Return what any of the areas covers."""
    return shapely.union_all([area for area in areas if area.area > 0])


def minus(area: Area, *hiding: Area) -> Area:
    """Return what of an area none of the others covers."""
    for other in hiding:
        if not other.is_empty and area.intersects(other):
            area = area.difference(other)
    return area


def common(one: Area, other: Area) -> Area:
    """Return what both areas cover."""
    return one.intersection(other)


def pairs_within(shapes: Sequence[shapely.Polygon], distance_mm: float) -> list[tuple[int, int]]:
    """Return the indices of all pairs of shapes that are at most so far apart, the lower first."""
    if not shapes:
        return []
    found = cast("Any", shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=distance_mm))
    return sorted((int(one), int(other)) for one, other in found.T if one < other)
