"""Which planar values does everything speak in?  Points, polygons, rigid motions and poses, in millimetres and degrees.

Angles count counter-clockwise seen from above, in a right-handed frame with Z up.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt
import shapely

__all__ = ["PlanarPose", "Points", "Polygon", "RigidTransform2D", "normalize_deg"]

Points = npt.NDArray[np.float64]
"""Points as rows: shape (n, 2), float64."""


def normalize_deg(angle_deg: float) -> float:
    """Return the same direction as an angle in (-180, 180]."""
    return -((-angle_deg + 180.0) % 360.0 - 180.0)


class PlanarPose(NamedTuple):
    """Where something lies in a plane: position in mm and the direction of its X axis in degrees."""

    x_mm: float
    y_mm: float
    a_deg: float


class RigidTransform2D(NamedTuple):
    """A rotation about the origin followed by a translation: p' = R·p + t."""

    rotation_deg: float
    x_mm: float
    y_mm: float

    @classmethod
    def identity(cls) -> Self:
        """Return the motion that changes nothing."""
        return cls(0.0, 0.0, 0.0)

    @property
    def matrix(self) -> Points:
        """The rotation, shape (2, 2)."""
        a = np.deg2rad(self.rotation_deg)
        return np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])

    def apply(self, points: Points) -> Points:
        """Return the moved points; the last axis of ``points`` holds x and y."""
        return np.asarray(points, float) @ self.matrix.T + (self.x_mm, self.y_mm)

    def apply_pose(self, pose: PlanarPose) -> PlanarPose:
        """Return the moved pose."""
        x, y = self.apply(np.array([pose.x_mm, pose.y_mm]))
        return PlanarPose(float(x), float(y), normalize_deg(pose.a_deg + self.rotation_deg))

    def __matmul__(self, first: "RigidTransform2D") -> "RigidTransform2D":
        """Return the motion that does ``first``, then this one."""
        x, y = self.apply(np.array([first.x_mm, first.y_mm]))
        return RigidTransform2D(normalize_deg(self.rotation_deg + first.rotation_deg), float(x), float(y))

    def inverse(self) -> "RigidTransform2D":
        """Return the motion that undoes this one."""
        x, y = -self.matrix.T @ (self.x_mm, self.y_mm)
        return RigidTransform2D(normalize_deg(-self.rotation_deg), float(x), float(y))


@dataclass(frozen=True)
class Polygon:
    """A simple polygon in mm: ``vertices`` has shape (n, 2), n ≥ 3, counter-clockwise, the first point not repeated.

    Use `from_points` for vertices in either orientation.
    """

    vertices: Points

    @classmethod
    def from_points(cls, points: npt.ArrayLike) -> Self:
        """Return a polygon of these vertices, turned counter-clockwise.  Raises ValueError on fewer than three."""
        vertices = np.array(points, dtype=np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 3:
            msg = f"a polygon needs at least three points of x and y, not an array of shape {vertices.shape}"
            raise ValueError(msg)
        if _signed_area(vertices) < 0:
            vertices = vertices[::-1].copy()
        vertices.setflags(write=False)
        return cls(vertices)

    @cached_property
    def shape(self) -> shapely.Polygon:
        """The same polygon as Shapely knows it."""
        return shapely.Polygon(self.vertices)

    @cached_property
    def area_mm2(self) -> float:
        """Enclosed area."""
        return _signed_area(self.vertices)

    @cached_property
    def centroid(self) -> Points:
        """Centre of the enclosed area, shape (2,); of one that encloses none, as nobody can lay it, of its vertices."""
        x, y = self.vertices.T
        cross = x * np.roll(y, -1) - np.roll(x, -1) * y
        if np.sum(cross) == 0.0:
            return self.vertices.mean(axis=0)
        cx = np.sum((x + np.roll(x, -1)) * cross)
        cy = np.sum((y + np.roll(y, -1)) * cross)
        return np.array([cx, cy]) / (3.0 * np.sum(cross))

    @cached_property
    def perimeter_mm(self) -> float:
        """Length of the outline."""
        return float(np.sum(np.linalg.norm(np.roll(self.vertices, -1, axis=0) - self.vertices, axis=1)))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest x and y, largest x and y."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def transformed(self, motion: RigidTransform2D) -> "Polygon":
        """Return this polygon moved rigidly."""
        return Polygon.from_points(motion.apply(self.vertices))


def _signed_area(vertices: Points) -> float:
    x, y = vertices.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
