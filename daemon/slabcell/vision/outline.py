"""How are outlines measured, widened and sampled?  Many closed polygons at once, as rings in one array."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points

__all__ = ["Rings", "distance_to_outline"]

Floats = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Rings:
    """Closed polygons, none empty: ``points`` (n, 2), and ``starts`` (rings + 1,) where each begins."""

    points: Points
    starts: Index

    @classmethod
    def of(cls, polygons: Sequence[Points]) -> "Rings":
        """Return these polygons together."""
        starts = np.zeros(len(polygons) + 1, np.intp)
        np.cumsum([len(polygon) for polygon in polygons], out=starts[1:])
        return cls(np.concatenate([*polygons, np.zeros((0, 2))]), starts)

    def __len__(self) -> int:
        return len(self.starts) - 1

    def moved(self, points: Points) -> "Rings":
        """Return rings with other points, as many in each."""
        return Rings(points, self.starts)

    @cached_property
    def owner(self) -> Index:
        """Index of the ring of each point."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))

    @cached_property
    def _next(self) -> Index:
        following = np.arange(1, len(self.points) + 1)
        following[self.starts[1:] - 1] = self.starts[:-1]
        return following

    @cached_property
    def _edges(self) -> tuple[Points, Floats]:
        """The vector to the next point, and its length."""
        edges = self.points[self._next] - self.points
        return edges, np.sqrt(edges[:, 0] ** 2 + edges[:, 1] ** 2)

    @cached_property
    def moments(self) -> tuple[Floats, Points, Floats]:
        """Signed area (counter-clockwise is positive), centroid, and normalised polar inertia of each ring.

        The inertia is the polar second moment about the centroid over the squared area: 1/(2π) for a disc, more else.
        """
        origin = self.points[self.starts[:-1]]
        here = self.points - origin[self.owner]
        there = here[self._next]
        cross = here[:, 0] * there[:, 1] - there[:, 0] * here[:, 1]
        square = here * here + here * there + there * there
        columns = np.column_stack([cross, (here + there) * cross[:, None], (square[:, 0] + square[:, 1]) * cross])
        sums = self._sums(columns)
        area = 0.5 * sums[:, 0]
        safe = np.where(np.abs(area) < 1e-12, 1.0, area)
        centre = sums[:, 1:3] / (6.0 * safe[:, None])
        polar = sums[:, 3] / 12.0 - area * (centre[:, 0] ** 2 + centre[:, 1] ** 2)
        inertia = np.where(np.abs(area) < 1e-12, np.inf, np.abs(polar) / safe**2)
        return area, centre + origin, inertia

    def _sums(self, columns: Floats) -> Floats:
        if len(self) == 0:
            return np.zeros((0, columns.shape[1]))
        return np.add.reduceat(columns, self.starts[:-1], axis=0)

    def counter_clockwise(self) -> "Rings":
        """Return the same rings, each counter-clockwise."""
        backward = (self.moments[0] < 0)[self.owner]
        if not np.any(backward):
            return self
        index = np.arange(len(self.points))
        mirrored = self.starts[:-1][self.owner] + self.starts[1:][self.owner] - 1 - index
        return self.moved(self.points[np.where(backward, mirrored, index)])

    def offset_outward(self, distance: float) -> "Rings":
        """Return counter-clockwise rings whose edges have moved outward; mitres are cut at twice the distance."""
        edges, length = self._edges
        normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.maximum(length, 1e-12)[:, None]
        before = np.empty_like(normals)
        before[self._next] = normals
        bisector = normals + before
        # |bisector|²/2 = 1 + cos of the turn; the mitre's length is 1/that along the bisector.
        scale = np.maximum(1.0 + normals[:, 0] * before[:, 0] + normals[:, 1] * before[:, 1], 0.5)
        return self.moved(self.points + distance * bisector / scale[:, None])

    def resampled(self, count: int) -> Floats:
        """Return ``count`` points of each ring at equal distances, from its first point on: (rings, count, 2)."""
        if len(self) == 0:
            return np.zeros((0, count, 2))
        edge, share = self._stations(count)
        points = self.points[edge] + share[:, None] * (self.points[self._next[edge]] - self.points[edge])
        return points.reshape(len(self), count, 2)

    def normals(self, count: int) -> npt.NDArray[np.complex128]:
        """Return the outward unit normals, x + iy, of counter-clockwise rings at their `resampled` points."""
        if len(self) == 0:
            return np.zeros((0, count), np.complex128)
        edges, length = self._edges
        outward = (edges[:, 1] - 1j * edges[:, 0]) / np.maximum(length, 1e-12)
        return outward[self._stations(count)[0]].reshape(len(self), count)

    def _stations(self, count: int) -> tuple[Index, Floats]:
        """Return the edge on which each of the resampled points lies, and how far along it, 0 ... 1."""
        _, length = self._edges
        # All rings one behind the other on one axis; each one's first point stands at its beginning and at its end.
        along = np.concatenate([[0.0], np.cumsum(length)])
        begin, end = along[self.starts[:-1]], along[self.starts[1:]]
        at = begin[:, None] + (end - begin)[:, None] * (np.arange(count) / count)
        edge = np.searchsorted(along, at.reshape(-1), side="right") - 1
        owner = np.repeat(np.arange(len(self)), count)
        edge = np.clip(edge, self.starts[:-1][owner], self.starts[1:][owner] - 1)
        share = (at.reshape(-1) - along[edge]) / np.maximum(length[edge], 1e-12)
        return edge, np.clip(share, 0.0, 1.0)


def distance_to_outline(points: Points, polygon: Points) -> npt.NDArray[np.float64]:
    """Return the distance of each point (n, 2) from the nearest point of a closed polygon's outline."""
    start = polygon[None, :, :]
    edge = np.roll(polygon, -1, axis=0)[None, :, :] - start
    relative = points[:, None, :] - start
    length = np.maximum(np.sum(edge**2, axis=2), 1e-18)
    share = np.clip(np.sum(relative * edge, axis=2) / length, 0.0, 1.0)
    away = relative - share[:, :, None] * edge
    return np.sqrt(np.sum(away**2, axis=2).min(axis=1))
