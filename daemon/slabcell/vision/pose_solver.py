"""Which small motions and offsets explain where the edges were measured?  Robust least squares.

All outlines are solved for at once.  The unknowns of an outline are x, y, its rotation about its middle, and one
uniform offset (the kerf).

This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.

Source of the weights: J. Tukey's biweight, as in P. Huber, "Robust Statistics", 1981.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["UNKNOWNS", "Measured", "Solution", "solve"]

Floats = npt.NDArray[np.float64]

UNKNOWNS = 4
ROBUST_STEPS = 6
# Cut of Tukey's biweight in robust standard deviations.
TUKEY = 4.7


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Where the pieces of outlines were found, in mm outward of where they were expected; arrays over pieces.

    ``starts`` (outlines + 1,) where the pieces of each outline begin; ``extras`` as in ProjectedEdges.
    """

    starts: npt.NDArray[np.int64]
    extras: Floats
    distance: Floats
    sigma: Floats
    valid: npt.NDArray[np.bool_]

    @property
    def owner(self) -> npt.NDArray[np.intp]:
        """Index of the outline of each piece."""
        return np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """``change`` (outlines, 4), its ``covariance`` (outlines, 4, 4), and what ``remains`` of each piece's distance."""

    change: Floats
    covariance: Floats
    remains: Floats


def solve(measured: Measured, prior: float) -> Solution:
    """Return the motions; ``prior`` is the weight (1/mm²) that holds what nothing measures where it is."""
    count = len(measured.starts) - 1
    owner, rows = measured.owner, measured.extras[:, 0:4].copy()
    arm = np.ones(count)
    np.maximum.at(arm, owner, np.abs(rows[:, 2]))
    rows[:, 2] /= arm[owner]
    base = np.where(measured.valid, 1.0 / measured.sigma**2, 0.0)
    robust = np.ones_like(base)
    unknown = np.zeros((count, UNKNOWNS))
    normal = np.tile(np.eye(UNKNOWNS), (count, 1, 1))
    remains = measured.distance
    spread = np.full(count, 0.5)
    for _ in range(ROBUST_STEPS):
        weight = base * robust
        normal = _sums(owner, weight[:, None, None] * rows[:, :, None] * rows[:, None, :], count)
        right = _sums(owner, (weight * measured.distance)[:, None] * rows, count)
        normal += np.eye(UNKNOWNS) * prior
        unknown = np.linalg.solve(normal, right[:, :, None])[:, :, 0].astype(np.float64, copy=False)
        remains = measured.distance - np.sum(rows * unknown[owner], axis=1)
        scaled = np.abs(remains) / measured.sigma
        spread = np.maximum(_medians(owner, np.where(measured.valid, scaled, np.nan), count) / 0.6745, 0.5)
        robust = np.maximum(1.0 - (scaled / (TUKEY * np.maximum(spread, 1.0)[owner])) ** 2, 0.0) ** 2
    unscale = np.column_stack([np.ones(count), np.ones(count), 1.0 / arm, np.ones(count)])
    covariance: Floats = np.linalg.inv(normal).astype(np.float64, copy=False)
    covariance = covariance * np.maximum(spread**2, 1.0)[:, None, None] * (unscale[:, :, None] * unscale[:, None, :])
    return Solution(unknown * unscale, covariance, remains)


def _sums(owner: npt.NDArray[np.intp], values: Floats, count: int) -> Floats:
    """Return sums over the pieces of each outline; pieces of one outline are neighbours."""
    starts = np.searchsorted(owner, np.arange(count))
    padded = np.concatenate([values, np.zeros((1, *values.shape[1:]))])
    sums = np.add.reduceat(padded, starts, axis=0)
    sums[np.bincount(owner, minlength=count) == 0] = 0.0
    return sums


def _medians(owner: npt.NDArray[np.intp], values: Floats, count: int) -> Floats:
    """Return the upper median of the finite values of each outline, 0 where there is none."""
    if len(values) == 0:
        return np.zeros(count)
    order = np.lexsort((values, owner))  # NaN sorts last
    usable = np.bincount(owner, np.isfinite(values), minlength=count).astype(np.intp)
    starts = np.searchsorted(owner, np.arange(count))
    at = np.minimum(starts + usable // 2, len(values) - 1)
    return np.where(usable > 0, np.nan_to_num(values[order][at]), 0.0)
