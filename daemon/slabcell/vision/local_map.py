"""How does the camera map a small part of the table?  Polynomials of fourth degree, one for each slab.

Within the size of a slab a lens is smooth: a polynomial through 36 points, mapped exactly, is good to 1e-3 px, and
costs a few multiplications per point where the full lens model costs hundreds.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.plane import PlaneView

__all__ = ["DEGREE", "MARGIN_PX", "TERMS", "LocalMaps", "map_locally", "nodes_of_maps"]

Floats = npt.NDArray[np.float64]

DEGREE = 4
# Powers of x and y of each term.
TERMS = tuple((total - power, power) for total in range(DEGREE + 1) for power in range(total + 1))
NODES = 6
# How far beyond an outline its map holds: the slab may lie that far from where it is expected.
MARGIN_PX = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class LocalMaps:
    """One map for each of n places: ``table`` (n, 3 + 4·terms) holds the columns that the properties name."""

    table: Floats

    @property
    def centre(self) -> Points:
        """Where each map is exact best, mm, (n, 2)."""
        return self.table[:, 0:2]

    @property
    def size(self) -> Floats:
        """How far each map reaches, mm, (n,)."""
        return self.table[:, 2]

    @property
    def top(self) -> Floats:
        """Polynomials (n, terms, 2) of (point - centre)/size: the pixel of a point of the plane of the upper faces."""
        return self.table[:, 3 : 3 + 2 * len(TERMS)].reshape(len(self), -1, 2)

    @property
    def foot(self) -> Floats:
        """The same for the point of the work plane below it, (n, terms, 2)."""
        return self.table[:, 3 + 2 * len(TERMS) :].reshape(len(self), -1, 2)

    def __len__(self) -> int:
        return len(self.table)


def map_locally(plane: PlaneView, centre: Points, size: Floats) -> LocalMaps:
    """Return maps about these centres (n, 2) that hold as far as ``size`` (n,) from them, in mm."""
    nodes, inverse = nodes_of_maps()
    count = len(centre)
    points = (centre[:, None, :] + size[:, None, None] * nodes).reshape(-1, 2)
    top = np.matmul(inverse, plane.to_pixels(points).reshape(count, -1, 2))
    foot = top
    if plane.height_mm != 0.0:
        below = plane.calibration.image_from_table(points, 0.0).reshape(count, -1, 2)
        foot = np.matmul(inverse, below)
    return LocalMaps(np.column_stack([centre, size, top.reshape(count, -1), foot.reshape(count, -1)]))


def monomials(x: Floats, y: Floats) -> Floats:
    """Return the terms at points: shape (n, terms)."""
    xs, ys = [np.ones_like(x)], [np.ones_like(y)]
    for _ in range(DEGREE):
        xs.append(xs[-1] * x)
        ys.append(ys[-1] * y)
    return np.stack([xs[i] * ys[j] for i, j in TERMS], axis=-1)


def derivatives(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return the derivatives of the terms after x and after y: shapes (n, terms)."""
    xs, ys = [np.ones_like(x)], [np.ones_like(y)]
    for _ in range(DEGREE):
        xs.append(xs[-1] * x)
        ys.append(ys[-1] * y)
    zero = np.zeros_like(x)
    by_x = [i * xs[i - 1] * ys[j] if i else zero for i, j in TERMS]
    by_y = [j * xs[i] * ys[j - 1] if j else zero for i, j in TERMS]
    return np.stack(by_x, axis=-1), np.stack(by_y, axis=-1)


def evaluate(coefficients: Floats, terms: Floats) -> Points:
    """Return the value of each point's polynomial: coefficients (n, terms, 2), terms (n, terms)."""
    return np.matmul(terms[:, None, :], coefficients)[:, 0, :]


@cache
def nodes_of_maps() -> tuple[Points, Floats]:
    """Return the places, in −1 ... 1, at which a map is sampled, and the matrix that makes coefficients of samples."""
    line = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(line, line))
    inverse: Floats = np.linalg.pinv(monomials(x, y)).astype(np.float64, copy=False)
    return np.ascontiguousarray(np.column_stack([x, y])), np.ascontiguousarray(inverse)
