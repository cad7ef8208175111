"""What is a picture like?  Its grey levels, its noise and its steepest edges, from a part of its pixels.

This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Survey", "step_of", "survey"]

Picture = npt.NDArray[np.uint8]
Counts = npt.NDArray[np.int64]

# Every fourth pixel of every fourth row is looked at, or every eighth of a large picture.
STEPS = (4, 8)
LARGE = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Counts over the 256 grey levels of a picture of 8 bits.

    ``grey``: how many of the pixels looked at have each level.  ``difference``: how many neighbours among them differ
    by each number of levels.  ``steepest``: the greatest difference over two pixels within each row that was searched,
    along it and across it.
    """

    grey: Counts
    difference: Counts
    steepest: Picture

    @property
    def noise(self) -> float:
        """Standard deviation of the pixel noise, from differences of neighbours, which edges barely touch."""
        total = int(self.difference.sum())
        if total == 0:
            return 0.0
        # The median of |N(0, s√2)| is 0.954 s; interpolated within its grey level.
        cumulative = np.cumsum(self.difference)
        middle = int(np.searchsorted(cumulative, 0.5 * total))
        before = float(cumulative[middle - 1]) if middle else 0.0
        share = (0.5 * total - before) / max(float(self.difference[middle]), 1.0)
        return max(0.0, middle - 0.5 + share) / 0.954


def step_of(picture: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> int:
    """Return how far apart the pixels are that are looked at."""
    return STEPS[1] if picture.size > LARGE else STEPS[0]


def survey(picture: Picture) -> Survey:
    """Return the survey of a picture of 8 bits, shape (h, w)."""
    height, width = picture.shape
    step = step_of(picture)
    sample = picture[::step, ::step]
    grey = np.bincount(sample.reshape(-1), minlength=256)
    rows = sample[::step].astype(np.int16)
    difference = np.bincount(np.abs(rows[:, 1:] - rows[:, :-1]).reshape(-1), minlength=256)
    steepest = np.zeros((-(-height // (2 * step)), 2), np.uint8)
    for index, v in enumerate(range(0, height, 2 * step)):
        row = picture[v].astype(np.int16)
        if width > 2:
            steepest[index, 0] = np.abs(row[2:] - row[:-2]).max()
        if 0 < v < height - 1:
            steepest[index, 1] = np.abs(picture[v + 1].astype(np.int16) - picture[v - 1]).max()
    return Survey(grey.astype(np.int64), difference.astype(np.int64), steepest.reshape(-1))
