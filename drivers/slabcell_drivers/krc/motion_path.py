"""Where is the tool centre point along a straight line or an arc?  Positions in mm, orientation as quaternion."""

import math
from dataclasses import dataclass
from typing import Protocol

from slabcell_drivers.robot.arm_solve import Pose

__all__ = [
    "Arc",
    "Line",
    "OrientedPath",
    "PointPath",
    "PosePath",
    "Quaternion",
    "Turning",
    "Vector",
    "flange_of",
    "quaternion_of",
    "rotation_of",
]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""

STRAIGHT_SINE = 1e-6  # three points whose angle has a smaller sine define no circle


def quaternion_of(rotation: tuple[Vector, Vector, Vector]) -> Quaternion:
    """Return the unit quaternion of a rotation matrix given by rows."""
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = rotation
    # the largest of the four squared components is computed by a root, the others by division: no loss near 180°
    squares = (1.0 + m00 + m11 + m22, 1.0 + m00 - m11 - m22, 1.0 - m00 + m11 - m22, 1.0 - m00 - m11 + m22)
    largest = squares.index(max(squares))
    s = 2.0 * math.sqrt(squares[largest])
    if largest == 0:
        return (0.25 * s, (m21 - m12) / s, (m02 - m20) / s, (m10 - m01) / s)
    if largest == 1:
        return ((m21 - m12) / s, 0.25 * s, (m01 + m10) / s, (m02 + m20) / s)
    if largest == 2:
        return ((m02 - m20) / s, (m01 + m10) / s, 0.25 * s, (m12 + m21) / s)
    return ((m10 - m01) / s, (m02 + m20) / s, (m12 + m21) / s, 0.25 * s)


def rotation_of(q: Quaternion) -> tuple[Vector, Vector, Vector]:
    """Return the rotation matrix, by rows, of a unit quaternion."""
    w, x, y, z = q
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@dataclass(frozen=True, slots=True)
class Turning:
    """The shortest turn from one orientation to another about one fixed axis, at even speed."""

    start: Quaternion
    end: Quaternion
    angle_deg: float

    @classmethod
    def between(cls, start: Quaternion, end: Quaternion) -> "Turning":
        """Return the turn between two orientations."""
        dot = sum(p * q for p, q in zip(start, end, strict=True))
        if dot < 0.0:  # a quaternion and its negative are one orientation; the nearer one makes the shorter turn
            end = (-end[0], -end[1], -end[2], -end[3])
        difference = math.hypot(*(p - q for p, q in zip(start, end, strict=True)))
        total = math.hypot(*(p + q for p, q in zip(start, end, strict=True)))
        return cls(start, end, math.degrees(4.0 * math.atan2(difference, total)))

    def at(self, fraction: float) -> Quaternion:
        """Return the orientation at this fraction of the turn."""
        half = math.radians(self.angle_deg) / 2.0
        if half < 1e-9:
            return self.end if fraction >= 1.0 else self.start
        k0, k1 = math.sin((1.0 - fraction) * half) / math.sin(half), math.sin(fraction * half) / math.sin(half)
        s, e = self.start, self.end
        return (k0 * s[0] + k1 * e[0], k0 * s[1] + k1 * e[1], k0 * s[2] + k1 * e[2], k0 * s[3] + k1 * e[3])


@dataclass(frozen=True, slots=True)
class Line:
    """A straight line."""

    start: Vector
    end: Vector

    @property
    def length_mm(self) -> float:
        """Length of the path."""
        return math.dist(self.start, self.end)

    def at(self, fraction: float) -> Vector:
        """Return the point at this fraction of the length."""
        rest = 1.0 - fraction
        return (
            rest * self.start[0] + fraction * self.end[0],
            rest * self.start[1] + fraction * self.end[1],
            rest * self.start[2] + fraction * self.end[2],
        )


@dataclass(frozen=True, slots=True)
class Arc:
    """An arc: centre, the two directions of its plane scaled to the radius, and the angle it covers."""

    centre: Vector
    first: Vector
    second: Vector
    angle_rad: float

    @classmethod
    def through(cls, start: Vector, middle: Vector, end: Vector, *, angle_deg: float | None = None) -> "Arc":
        """Return the arc from start over middle to end, or over ``angle_deg`` of that circle (negative: backwards).

        Raises ValueError if the three points define no circle.
        """
        to_middle, to_end = _minus(middle, start), _minus(end, start)
        normal = _cross(to_middle, to_end)
        size = math.hypot(*normal)
        if size <= STRAIGHT_SINE * math.hypot(*to_middle) * math.hypot(*to_end) or size == 0.0:
            msg = "start, auxiliary and end point of a circle are in one place or on one line"
            raise ValueError(msg)
        middle_square, end_square = _dot(to_middle, to_middle), _dot(to_end, to_end)
        combined = _minus(_scaled(to_end, middle_square), _scaled(to_middle, end_square))
        offset = _scaled(_cross(combined, normal), 0.5 / (size * size))
        centre = (start[0] + offset[0], start[1] + offset[1], start[2] + offset[2])
        first = _minus(start, centre)
        second = _cross(_scaled(normal, 1.0 / size), first)
        reach = _minus(end, centre)
        covered = math.atan2(_dot(reach, second), _dot(reach, first)) % (2.0 * math.pi)
        return cls(centre, first, second, covered if angle_deg is None else math.radians(angle_deg))

    @property
    def length_mm(self) -> float:
        """Length of the path."""
        return math.hypot(*self.first) * abs(self.angle_rad)

    def at(self, fraction: float) -> Vector:
        """Return the point at this fraction of the length."""
        cosine, sine = math.cos(fraction * self.angle_rad), math.sin(fraction * self.angle_rad)
        return (
            self.centre[0] + cosine * self.first[0] + sine * self.second[0],
            self.centre[1] + cosine * self.first[1] + sine * self.second[1],
            self.centre[2] + cosine * self.first[2] + sine * self.second[2],
        )


class PosePath(Protocol):
    """A way of the tool centre point, position and orientation."""

    @property
    def length_mm(self) -> float:
        """Length of the way."""
        ...

    @property
    def angle_deg(self) -> float:
        """How far the orientation turns altogether."""
        ...

    @property
    def marks(self) -> tuple[float, ...]:
        """At which fractions the points between start and end lie."""
        ...

    def at(self, fraction: float) -> Pose:
        """Return the pose at this fraction of the way."""
        ...


class PointPath(Protocol):
    """A way of a point."""

    @property
    def length_mm(self) -> float:
        """Length of the way."""
        ...

    def at(self, fraction: float) -> Vector:
        """Return the point at this fraction of the length."""
        ...


@dataclass(frozen=True, slots=True)
class OrientedPath:
    """A way of a point on which the orientation turns evenly."""

    path: PointPath
    turning: Turning
    marks: tuple[float, ...] = ()

    @classmethod
    def between(cls, path: PointPath, start: Pose, end: Pose) -> "OrientedPath":
        """Return the way with the orientations of its two ends."""
        return cls(path, Turning.between(quaternion_of(start.rotation), quaternion_of(end.rotation)))

    @property
    def length_mm(self) -> float:
        """Length of the way."""
        return self.path.length_mm

    @property
    def angle_deg(self) -> float:
        """How far the orientation turns."""
        return self.turning.angle_deg

    def at(self, fraction: float) -> Pose:
        """Return the pose at this fraction of the way."""
        return Pose(self.path.at(fraction), rotation_of(self.turning.at(fraction)))


def flange_of(tcp: Pose, tool_inverse: Pose) -> Pose:
    """Return the flange for a tool centre point and the inverse of its tool: the product of the two."""
    r, t = tcp.rotation, tool_inverse.rotation
    p = tool_inverse.position
    position = (
        tcp.position[0] + r[0][0] * p[0] + r[0][1] * p[1] + r[0][2] * p[2],
        tcp.position[1] + r[1][0] * p[0] + r[1][1] * p[1] + r[1][2] * p[2],
        tcp.position[2] + r[2][0] * p[0] + r[2][1] * p[1] + r[2][2] * p[2],
    )
    rows = tuple(
        (
            a * t[0][0] + b * t[1][0] + c * t[2][0],
            a * t[0][1] + b * t[1][1] + c * t[2][1],
            a * t[0][2] + b * t[1][2] + c * t[2][2],
        )
        for a, b, c in r
    )
    return Pose(position, (rows[0], rows[1], rows[2]))


def _minus(p: Vector, q: Vector) -> Vector:
    return (p[0] - q[0], p[1] - q[1], p[2] - q[2])


def _scaled(p: Vector, factor: float) -> Vector:
    return (p[0] * factor, p[1] * factor, p[2] * factor)


def _dot(p: Vector, q: Vector) -> float:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def _cross(p: Vector, q: Vector) -> Vector:
    return (p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])
