"""Where are flange and axes when the tool stands on a slab, and the flange above it?

Plain floats, for one slab at a time; the axes of many in one call of the compiled library, where there is one.

The tool looks down on the slab: its frame in that of the table is Rz(a) Rx(180°) at the grasp point (`planning`).
"""

import math
from collections.abc import Sequence

import numpy as np

from slabcell.geometry import PlanarPose
from slabcell_drivers.robot.arm import ArmModel, Axes
from slabcell_drivers.robot.arm_solve import Pose, Vector
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.native import NativeDescent, native_library

__all__ = ["Descent", "DescentTo"]

Descent = tuple[Pose, Pose]
"""The flange above a pose, and at it."""


class DescentTo:
    """The way straight down to poses in one base, for one arm and one tool; lengths in mm."""

    def __init__(self, base: Frame, tool: Frame, approach_mm: float, arm: ArmModel) -> None:
        """``approach_mm`` counts along the Z axis of the base, which may be tilted."""
        self._flange_in_tool = tuple(_vector(column) for column in np.linalg.inv(tool.matrix).T.tolist())
        rows = base.matrix.tolist()
        self._rows = tuple((*_vector(row), float(row[3])) for row in rows[:3])
        x, y, z = (approach_mm * row[2] for row in self._rows)
        self._up = (x, y, z)
        library = native_library()
        self._native = library and NativeDescent(
            library, arm, flange_in_tool=self._flange_in_tool, base=self._rows, up=self._up
        )

    def quickly(
        self, poses: Sequence[tuple[PlanarPose, float]], status: int | None
    ) -> tuple[list[Axes | None], int | None]:
        """Return for poses and heights the axes there, where the arm gets straight down to them in one configuration.

        They are those that `ArmModel.inverse` gives, above first and then at the pose; the configuration is ``status``,
        or the one of the first pose that is reached, and is returned too.  None where the arm does not get there so, or
        where nothing is compiled: then it has to be asked.
        """
        if self._native is None:
            return [None] * len(poses), status
        return self._native.axes([(pose.x_mm, pose.y_mm, pose.a_deg, height) for pose, height in poses], status)

    def __call__(self, pose: PlanarPose, height_mm: float) -> Descent:
        """Return the flange in the root frame, above a pose and at it, with the tool unturned."""
        angle = math.radians(pose.a_deg)
        c, s = math.cos(angle), math.sin(angle)
        (x0, x1, x2), (y0, y1, y2), (z0, z1, z2), (p0, p1, p2) = (
            (c * f0 + s * f1, s * f0 - c * f1, -f2) for f0, f1, f2 in self._flange_in_tool
        )
        p0, p1, p2 = p0 + pose.x_mm, p1 + pose.y_mm, p2 + height_mm
        (a0, a1, a2, px), (b0, b1, b2, py), (c0, c1, c2, pz) = self._rows
        rotation = (
            (a0 * x0 + a1 * x1 + a2 * x2, a0 * y0 + a1 * y1 + a2 * y2, a0 * z0 + a1 * z1 + a2 * z2),
            (b0 * x0 + b1 * x1 + b2 * x2, b0 * y0 + b1 * y1 + b2 * y2, b0 * z0 + b1 * z1 + b2 * z2),
            (c0 * x0 + c1 * x1 + c2 * x2, c0 * y0 + c1 * y1 + c2 * y2, c0 * z0 + c1 * z1 + c2 * z2),
        )
        x = a0 * p0 + a1 * p1 + a2 * p2 + px
        y = b0 * p0 + b1 * p1 + b2 * p2 + py
        z = c0 * p0 + c1 * p1 + c2 * p2 + pz
        up_x, up_y, up_z = self._up
        return Pose((x + up_x, y + up_y, z + up_z), rotation), Pose((x, y, z), rotation)


def _vector(values: list[float]) -> Vector:
    return float(values[0]), float(values[1]), float(values[2])
