"""What is a pose in space?  KUKA's FRAME: X Y Z in mm, A B C in degrees, with R = Rz(A)·Ry(B)·Rx(C).

Source: KUKA System Software 8.x, operating and programming instructions, "Coordinate systems"; the convention was
confirmed on taught points of public controller backups.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

__all__ = ["Frame"]


@dataclass(frozen=True, slots=True)
class Frame:
    """Position and orientation relative to a parent frame."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0
    a_deg: float = 0.0
    b_deg: float = 0.0
    c_deg: float = 0.0

    @property
    def matrix(self) -> npt.NDArray[np.float64]:
        """Homogeneous matrix, shape (4, 4): takes coordinates in this frame to coordinates in its parent."""
        a, b, c = np.deg2rad((self.a_deg, self.b_deg, self.c_deg))
        ca, sa, cb, sb, cc, sc = np.cos(a), np.sin(a), np.cos(b), np.sin(b), np.cos(c), np.sin(c)
        return np.array(
            [
                [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc, self.x_mm],
                [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc, self.y_mm],
                [-sb, cb * sc, cb * cc, self.z_mm],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )

    @classmethod
    def from_matrix(cls, matrix: npt.NDArray[np.float64]) -> Self:
        """Return the frame of a homogeneous matrix; with B at ±90° (gimbal lock) C is 0 by convention."""
        m = np.asarray(matrix, float)
        cb = float(np.hypot(m[0, 0], m[1, 0]))
        b = np.arctan2(-m[2, 0], cb)
        if cb > 1e-9:
            a, c = np.arctan2(m[1, 0], m[0, 0]), np.arctan2(m[2, 1], m[2, 2])
        else:
            a, c = np.arctan2(-m[0, 1], m[1, 1]), 0.0
        angles = np.rad2deg((a, b, c))
        return cls(float(m[0, 3]), float(m[1, 3]), float(m[2, 3]), float(angles[0]), float(angles[1]), float(angles[2]))

    def __matmul__(self, child: "Frame") -> "Frame":
        """Return ``child``, given in this frame, in this frame's parent: KRL's geometric operator ``:``."""
        return Frame.from_matrix(self.matrix @ child.matrix)

    def inverse(self) -> "Frame":
        """Return the parent as seen from this frame."""
        m = self.matrix
        inverse = np.eye(4)
        inverse[:3, :3] = m[:3, :3].T
        inverse[:3, 3] = -m[:3, :3].T @ m[:3, 3]
        return Frame.from_matrix(inverse)

    def as_tuple(self) -> tuple[float, float, float, float, float, float]:
        """Return X, Y, Z, A, B, C."""
        return self.x_mm, self.y_mm, self.z_mm, self.a_deg, self.b_deg, self.c_deg
