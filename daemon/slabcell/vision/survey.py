"""What is a picture like?  Its grey levels, its noise and its steepest edges, from a part of its pixels.

This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.vision.thresholds import Split, split_in_two

__all__ = ["Survey", "lightest_of", "rim_of", "step_of", "survey"]

Picture = npt.NDArray[np.uint8]
Counts = npt.NDArray[np.int64]

# Every fourth pixel of every fourth row is looked at, or every eighth of a large picture.
STEPS = (4, 8)
LARGE = 1 << 20
# Of the rows that are looked at one of so many is searched for steep edges.
SEARCHED = 2
# Of the rows that were searched, those with the sharpest edges.
STEEPEST = 4


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a picture of 8 bits is like.

    ``grey`` (256,): how many of the pixels looked at have each level; ``rim`` (256,): the same of the outermost pixels.
    ``noise``: standard deviation of the pixel noise.  ``sharpest``: the greatest difference of levels over two pixels,
    or None for a picture too small to say.  ``lightest``: the level that half a percent of the pixels exceed.
    ``split``: the best split of the levels in two populations, or None where there are none.
    """

    grey: Counts
    rim: Counts
    noise: float
    sharpest: float | None
    lightest: int
    split: Split | None


def step_of(picture: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]) -> int:
    """Return how far apart the pixels are that are looked at."""
    return STEPS[1] if picture.size > LARGE else STEPS[0]


def survey(picture: Picture) -> Survey:
    """Return the survey of a picture of 8 bits, shape (h, w)."""
    height, width = picture.shape
    step = step_of(picture)
    sample = picture[::step, ::step]
    grey = np.bincount(sample.reshape(-1), minlength=256).astype(np.int64)
    rows = sample[::step].astype(np.int16)
    difference = np.bincount(np.abs(rows[:, 1:] - rows[:, :-1]).reshape(-1), minlength=256).astype(np.int64)
    steepest: list[int] = []
    for v in range(0, height, SEARCHED * step):
        row = picture[v].astype(np.int16)
        steepest.append(int(np.abs(row[2:] - row[:-2]).max()) if width > 2 else 0)
        across = 0 < v < height - 1
        steepest.append(int(np.abs(picture[v + 1].astype(np.int16) - picture[v - 1]).max()) if across else 0)
    # The median of the steepest rows, or the one below the middle of them.
    sharpest = float(sorted(steepest)[-STEEPEST // 2]) if len(steepest) >= STEEPEST else None
    split = split_in_two(grey)
    return Survey(grey, rim_of(picture), _noise_of(difference), sharpest, lightest_of(grey), split)


def rim_of(picture: Picture) -> Counts:
    """Return how many of the outermost pixels have each level, from every fourth of them."""
    sides = (picture[0, ::4], picture[-1, ::4], picture[::4, 0], picture[::4, -1])
    return np.bincount(np.concatenate(sides), minlength=256).astype(np.int64)


def lightest_of(grey: Counts) -> int:
    """Return the level that half a percent of the pixels exceed, from how many have each level."""
    total = int(grey.sum())
    return max(255 - int(np.count_nonzero(np.cumsum(grey[::-1]) <= total // 200)), 0)


def _noise_of(difference: Counts) -> float:
    """Return the pixel noise, from how many neighbours differ by each number of levels, which edges barely touch."""
    total = int(difference.sum())
    if total == 0:
        return 0.0
    # The median of |N(0, s√2)| is 0.954 s; interpolated within its grey level.
    cumulative = np.cumsum(difference)
    middle = int(np.searchsorted(cumulative, 0.5 * total))
    before = float(cumulative[middle - 1]) if middle else 0.0
    share = (0.5 * total - before) / max(float(difference[middle]), 1.0)
    return max(0.0, middle - 0.5 + share) / 0.954
