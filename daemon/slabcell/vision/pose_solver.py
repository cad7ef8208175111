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
# Steps of the weights at most; an outline is done when a step moves it by less than CONVERGED_MM.
ROBUST_STEPS = 8
CONVERGED_MM = 1e-5
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
    """``change`` (outlines, 4), its ``covariance`` (outlines, 4, 4), and what ``remains`` of each piece's distance.

    The covariance is what the pieces' own sigmas say; ``spread`` (outlines,) is how much more or less their distances
    scatter than that, robustly: 1 as they should.
    """

    change: Floats
    covariance: Floats
    spread: Floats
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
    spread = np.zeros(count)
    moving = np.ones(count, np.bool_)
    for step in range(ROBUST_STEPS):
        weight = base * robust
        now = (
            _sums(owner, weight[:, None, None] * rows[:, :, None] * rows[:, None, :], count) + np.eye(UNKNOWNS) * prior
        )
        right = _sums(owner, (weight * measured.distance)[:, None] * rows, count)
        found = np.linalg.solve(now, right[:, :, None])[:, :, 0].astype(np.float64, copy=False)
        away = np.abs(found - unknown).max(axis=1)
        unknown = np.where(moving[:, None], found, unknown)
        normal = np.where(moving[:, None, None], now, normal)
        remains = measured.distance - np.sum(rows * unknown[owner], axis=1)
        scaled = np.abs(remains) / measured.sigma
        spread = _medians(owner, np.where(measured.valid, scaled, np.nan), count) / 0.6745
        if step:
            moving = moving & (away >= CONVERGED_MM)
        again = np.maximum(1.0 - (scaled / (TUKEY * np.maximum(spread, 1.0)[owner])) ** 2, 0.0) ** 2
        robust = np.where(moving[owner], again, robust)
    unscale = np.column_stack([np.ones(count), np.ones(count), 1.0 / arm, np.ones(count)])
    covariance: Floats = np.linalg.inv(normal).astype(np.float64, copy=False)
    covariance = covariance * (unscale[:, :, None] * unscale[:, None, :])
    return Solution(unknown * unscale, covariance, spread, remains)


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
