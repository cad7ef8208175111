"""How do the flange pose and the axis angles of a KUKA arm follow from each other?  Closed form, both ways.

Plain floats and no arrays: one pose at a time, a few tens of microseconds, about 1e-13 relative.  The chain is, with
the signs of every KUKA arm of this build::

    Tz(base_height) Rz(-A1) Tx(shoulder) Ry(A2) Tx(upper_arm) Ry(A3) T(forearm_x, 0, forearm_z)
    Rx(-A4) Ry(A5) Rx(-A6) Tx(flange) Ry(90°)

Source of the chain: the URDF that ROS-Industrial publishes for the KR 3 R540 (``kuka_kr3_support``).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from slabcell_drivers.robot.frame import Frame

__all__ = ["Axes", "Dimensions", "Pose", "Vector", "flange_pose", "pose_of_frame", "solve", "solve_main_axes"]

Axes = tuple[float, float, float, float, float, float]
"""A1 to A6 in degrees."""

Vector = tuple[float, float, float]
Rotation = tuple[Vector, Vector, Vector]

WRIST_SINGULAR_SINE = 1e-10
"""Below this sine of A5 the axes A4 and A6 are one line; a pose written in degrees is rounded to about 1e-15."""
SHOULDER_SINGULAR_MM = 1e-7
STRETCHED_TOLERANCE_MM = 1e-7
ZERO_DEG = 1e-9  # an angle nearer to zero is zero: the sign of its rounding would change the turn


@dataclass(frozen=True, slots=True)
class Dimensions:
    """Dimensions in mm; in ``$machine.dat``: TIRORO.Z, LENGTH_A, LENGTH_B, TX3P3.X, TX3P3.Z, TFLWP.Z."""

    base_height_mm: float
    shoulder_mm: float
    upper_arm_mm: float
    forearm_x_mm: float
    forearm_z_mm: float
    flange_mm: float


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose as position in mm and rotation matrix by rows."""

    position: Vector
    rotation: Rotation

    def to_frame(self) -> Frame:
        """Return the same pose as X Y Z A B C."""
        (r00, r01, _), (r10, r11, _), (r20, r21, r22) = self.rotation
        cos_b = math.hypot(r00, r10)
        b = math.atan2(-r20, cos_b)
        if cos_b > 1e-9:
            a, c = math.atan2(r10, r00), math.atan2(r21, r22)
        else:
            a, c = math.atan2(-r01, r11), 0.0
        return Frame(*self.position, math.degrees(a), math.degrees(b), math.degrees(c))


def pose_of_frame(frame: Frame) -> Pose:
    """Return the same pose as position and rotation matrix."""
    a, b, c = math.radians(frame.a_deg), math.radians(frame.b_deg), math.radians(frame.c_deg)
    ca, sa, cb, sb, cc, sc = math.cos(a), math.sin(a), math.cos(b), math.sin(b), math.cos(c), math.sin(c)
    return Pose(
        (frame.x_mm, frame.y_mm, frame.z_mm),
        (
            (ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc),
            (sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc),
            (-sb, cb * sc, cb * cc),
        ),
    )


def flange_pose(dimensions: Dimensions, axes_deg: Axes) -> Pose:
    """Return the flange in the root frame."""
    d = dimensions
    a1, a2, a3, a4, a5, a6 = (math.radians(angle) for angle in axes_deg)
    c1, s1 = math.cos(a1), -math.sin(a1)
    c23, s23 = math.cos(a2 + a3), math.sin(a2 + a3)
    c4, s4, c5, s5, c6, s6 = math.cos(a4), -math.sin(a4), math.cos(a5), math.sin(a5), math.cos(a6), -math.sin(a6)

    # the wrist rotation Rx(-A4)·Ry(A5)·Rx(-A6), then in the arm's plane, then turned by A1; last Ry(90°) maps z to x
    w = (
        (c5, s5 * s6, s5 * c6),
        (s4 * s5, c4 * c6 - s4 * c5 * s6, -c4 * s6 - s4 * c5 * c6),
        (-c4 * s5, s4 * c6 + c4 * c5 * s6, -s4 * s6 + c4 * c5 * c6),
    )
    arm = tuple((c23 * w[0][j] + s23 * w[2][j], w[1][j], -s23 * w[0][j] + c23 * w[2][j]) for j in range(3))
    columns = tuple((c1 * x - s1 * y, s1 * x + c1 * y, z) for x, y, z in arm)
    x_column, y_column, z_column = columns
    rotation = (
        (-z_column[0], y_column[0], x_column[0]),
        (-z_column[1], y_column[1], x_column[1]),
        (-z_column[2], y_column[2], x_column[2]),
    )
    wrist_x = d.shoulder_mm + d.upper_arm_mm * math.cos(a2) + d.forearm_x_mm * c23 + d.forearm_z_mm * s23
    wrist_z = d.base_height_mm - d.upper_arm_mm * math.sin(a2) - d.forearm_x_mm * s23 + d.forearm_z_mm * c23
    position = (
        c1 * wrist_x + d.flange_mm * x_column[0],
        s1 * wrist_x + d.flange_mm * x_column[1],
        wrist_z + d.flange_mm * x_column[2],
    )
    return Pose(position, rotation)


def solve(
    dimensions: Dimensions,
    flange: Pose,
    *,
    a1_if_singular_deg: float = 0.0,
    a4_if_singular_deg: float = 0.0,
    status: int | None = None,
    allowed: Callable[[Vector], bool] | None = None,
) -> list[tuple[int, Axes]]:
    """Return up to eight sets of axis angles with their status; none if out of reach.

    Angles are in (-180, 180], limits are not regarded.  With ``status`` only that one is computed, with ``allowed``
    only those whose A1, A2, A3 (degrees) it lets pass: what a limit forbids needs no wrist.
    """
    d = dimensions
    r = flange.rotation
    wx = flange.position[0] - d.flange_mm * r[0][2]
    wy = flange.position[1] - d.flange_mm * r[1][2]
    wz = flange.position[2] - d.flange_mm * r[2][2] - d.base_height_mm
    radius = math.hypot(wx, wy)
    front = -math.atan2(wy, wx) if radius > SHOULDER_SINGULAR_MM else math.radians(a1_if_singular_deg)
    a4_if_singular = math.radians(a4_if_singular_deg)
    found: list[tuple[int, Axes]] = []
    for behind, a1, forward in ((0, front, radius), (1, front + math.pi, -radius)):
        if status is not None and status & 1 != behind:
            continue
        for elbow, a2, a3 in _arm(d, forward - d.shoulder_mm, wz):
            if status is not None and status & 2 != elbow:
                continue
            main = (_deg(a1), _deg(a2), _deg(a3))
            if allowed is not None and not allowed(main):
                continue
            for flipped, a4, a5, a6 in _wrist(r, a1, a2 + a3, a4_if_singular):
                if status is None or status & 4 == flipped:
                    found.append((behind | elbow | flipped, (*main, _deg(a4), _deg(a5), _deg(a6))))
    return found


def solve_main_axes(
    dimensions: Dimensions, wrist_deg: Vector, tcp_in_flange: Vector, position: Vector
) -> list[tuple[int, Vector]]:
    """Return up to four A1, A2, A3 (degrees) that bring a point of the tool there while A4 to A6 are given.

    Each comes with the side it is on: bit 0 for the point behind the A1 axis, bit 1 of the elbow.  ``tcp_in_flange`` is
    that point in the flange, ``position`` where it shall be in the root frame, both in mm.
    """
    d = dimensions
    a4, a5, a6 = (math.radians(angle) for angle in wrist_deg)
    c4, s4, c5, s5, c6, s6 = math.cos(a4), -math.sin(a4), math.cos(a5), math.sin(a5), math.cos(a6), -math.sin(a6)
    ux, uy, uz = d.flange_mm + tcp_in_flange[2], tcp_in_flange[1], -tcp_in_flange[0]
    # the point seen from the forearm, as if the forearm itself reached there
    vx = d.forearm_x_mm + c5 * ux + s5 * s6 * uy + s5 * c6 * uz
    vy = s4 * s5 * ux + (c4 * c6 - s4 * c5 * s6) * uy - (c4 * s6 + s4 * c5 * c6) * uz
    vz = d.forearm_z_mm - c4 * s5 * ux + (s4 * c6 + c4 * c5 * s6) * uy + (c4 * c5 * c6 - s4 * s6) * uz
    square = position[0] ** 2 + position[1] ** 2 - vy * vy
    if square < 0.0:
        return []
    reach = Dimensions(d.base_height_mm, d.shoulder_mm, d.upper_arm_mm, vx, vz, d.flange_mm)
    found: list[tuple[int, Vector]] = []
    for behind, forward in ((0, math.sqrt(square)), (1, -math.sqrt(square))):
        a1 = math.atan2(vy, forward) - math.atan2(position[1], position[0])
        for elbow, a2, a3 in _arm(reach, forward - d.shoulder_mm, position[2] - d.base_height_mm):
            found.append((behind | elbow, (_deg(a1), _deg(a2), _deg(a3))))
    return found


def _arm(d: Dimensions, x: float, z: float) -> list[tuple[int, float, float]]:
    """Return A2 and A3 (radians) that bring the wrist to x, z of the A2 axis, each with its bit of the status."""
    upper, fore = d.upper_arm_mm, math.hypot(d.forearm_x_mm, d.forearm_z_mm)
    stretched = math.atan2(d.forearm_z_mm, d.forearm_x_mm)
    distance = math.hypot(x, z)
    # as products and not as an arc cosine: full precision where the arm is almost stretched or folded
    beyond = upper + fore - distance
    before = distance - abs(upper - fore)
    if beyond < -STRETCHED_TOLERANCE_MM or before < -STRETCHED_TOLERANCE_MM:
        return []
    far = max(beyond, 0.0) * (upper + fore + distance)
    close = max(before, 0.0) * (distance + abs(upper - fore))
    bend = 2.0 * math.atan2(math.sqrt(far), math.sqrt(close))
    direction = math.atan2(-z, x)
    lead = math.atan2(fore * math.sin(bend), upper + fore * math.cos(bend))
    return [(2, direction - lead, bend + stretched), (0, direction + lead, stretched - bend)]


def _wrist(r: Rotation, a1: float, a23: float, a4_if_singular: float) -> list[tuple[int, float, float, float]]:
    """Return A4, A5, A6 (radians) that give the flange this rotation, each with its bit of the status."""
    c1, s1, c23, s23 = math.cos(a1), -math.sin(a1), math.cos(a23), math.sin(a23)
    # the columns of R·Ry(-90°), seen from the forearm: x is the flange's z, z is minus the flange's x
    x, y, z = r[0][2], r[1][2], r[2][2]
    plane = c1 * x + s1 * y
    m00, m10, m20 = c23 * plane - s23 * z, c1 * y - s1 * x, s23 * plane + c23 * z
    x, y, z = r[0][1], r[1][1], r[2][1]
    plane = c1 * x + s1 * y
    m01, m11, m21 = c23 * plane - s23 * z, c1 * y - s1 * x, s23 * plane + c23 * z
    x, y, z = r[0][0], r[1][0], r[2][0]
    m02 = s23 * z - c23 * (c1 * x + s1 * y)
    sine = math.hypot(m10, m20)
    if sine < WRIST_SINGULAR_SINE and m00 > 0.0:
        return [(0, a4_if_singular, 0.0, -math.atan2(m21, m11) - a4_if_singular)]
    a5 = math.atan2(sine, m00)
    return [
        (0, -math.atan2(m10, -m20), a5, -math.atan2(m01, m02)),
        (4, -math.atan2(-m10, m20), -a5, -math.atan2(-m01, -m02)),
    ]


def _deg(angle: float) -> float:
    """Return the angle in degrees, in (-180, 180]."""
    degrees = -((-math.degrees(angle) + 180.0) % 360.0 - 180.0)
    return 0.0 if abs(degrees) < ZERO_DEG else degrees
