"""Which grey level separates table and slab?  Levels from the histogram, for the whole picture.

Sources: N. Otsu, "A threshold selection method from gray-level histograms", IEEE SMC 9(1), 1979; here on the logarithm
of the grey level, because light multiplies.  P. Liao and others, "A fast algorithm for multilevel thresholding", J.
Information Science and Engineering 17(5), 2001, for several levels.  The dynamic levels are those of the blob tools of
machine vision: a share of the range that remains when the tails of the histogram are left out.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

__all__ = ["DARK_OFFSET", "Split", "dynamic_range", "several_levels", "split_in_two"]

Levels = npt.NDArray[np.int64]

# Added before the logarithm, in grey levels: below it the picture is noise, not reflectance.
DARK_OFFSET = 8.0
# Of the 256 levels.
LOGARITHMS = np.log(np.arange(256) + DARK_OFFSET)
# Grey levels of the coarser histogram on which several thresholds are searched for exhaustively.
COARSE_LEVELS = 64


@dataclass(frozen=True, slots=True)
class Split:
    """Two populations of grey: the level between them, their means, and the share of pixels half way between.

    The share is one of the smaller population.
    """

    level: float
    dark: float
    light: float
    valley_share: float

    @classmethod
    def of(cls, level: float, dark: float, light: float, valley_share: float) -> Self:
        """Return a split whose means are `LOGARITHMS`."""
        return cls(level, math.exp(dark) - DARK_OFFSET, math.exp(light) - DARK_OFFSET, valley_share)


def split_in_two(histogram: npt.NDArray[np.int64]) -> Split | None:
    """Return the best split of a histogram of 256 levels in two populations, or None if all pixels have one grey.

    This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
    """
    weight = np.cumsum(histogram).astype(np.float64)
    moment = np.cumsum(histogram * LOGARITHMS)
    below, above = weight[:-1], weight[-1] - weight[:-1]
    usable = (below > 0) & (above > 0)
    if not np.any(usable):
        return None
    mean_below = moment[:-1] / np.maximum(below, 1)
    mean_above = (moment[-1] - moment[:-1]) / np.maximum(above, 1)
    between = np.where(usable, below * above * (mean_above - mean_below) ** 2, 0.0)
    # Between two populations with a gap the criterion is flat: take the middle of the plateau.
    best = np.flatnonzero(between >= between.max() * (1 - 1e-9))
    cut = int(best[len(best) // 2])
    low, high = float(mean_below[cut]), float(mean_above[cut])
    between_both = (low + 0.35 * (high - low) < LOGARITHMS) & (low + 0.65 * (high - low) > LOGARITHMS)
    return Split.of(cut + 0.5, low, high, float(histogram[between_both].sum() / min(below[cut], above[cut])))


def dynamic_range(histogram: Levels, low_tail_percent: float, high_tail_percent: float) -> tuple[float, float]:
    """Return the grey levels that remain when these shares of the darkest and lightest pixels are left out."""
    share = np.cumsum(histogram) / max(float(histogram.sum()), 1.0)
    low = int(np.count_nonzero(share < low_tail_percent / 100.0))
    high = int(np.count_nonzero(share < 1.0 - high_tail_percent / 100.0))
    return float(low), float(max(high, low + 1))


def several_levels(histogram: Levels, classes: int) -> list[float]:
    """Return the levels between so many populations, ascending: exhaustive on a coarse histogram of logarithms."""
    values = np.log(np.arange(256) + DARK_OFFSET)
    place = (values - values[0]) / (values[-1] - values[0]) * COARSE_LEVELS
    coarse = np.bincount(np.minimum(place.astype(np.intp), COARSE_LEVELS - 1), histogram, minlength=COARSE_LEVELS)
    weight = np.concatenate([[0.0], np.cumsum(coarse)])
    moment = np.concatenate([[0.0], np.cumsum(coarse * np.arange(COARSE_LEVELS))])
    mass = weight[None, :] - weight[:, None]
    first = moment[None, :] - moment[:, None]
    gain = np.where(mass > 0, first**2 / np.maximum(mass, 1.0), 0.0)
    # best[k][j]: greatest sum over the first k classes that end at level j.
    best = gain[0].copy()
    cuts: list[npt.NDArray[np.intp]] = []
    order = np.arange(COARSE_LEVELS + 1)
    for _ in range(classes - 1):
        total = np.where(order[:, None] < order[None, :], best[:, None] + gain, -1.0)
        cuts.append(np.argmax(total, axis=0))
        best = total.max(axis=0)
    end = COARSE_LEVELS
    levels: list[float] = []
    for back in reversed(cuts):
        end = int(back[end])
        at = values[0] + (values[-1] - values[0]) * end / COARSE_LEVELS
        levels.append(float(np.exp(at) - DARK_OFFSET))
    return levels[::-1]
