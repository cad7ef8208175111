"""Which share of each pixel does a polygon cover?  Exactly, by the signed area that each edge leaves to its right.

Every edge is cut where it crosses a pixel border; each piece then lies in one pixel, where the area between it and the
pixel's right border is a trapezium.  Summing along rows gives the covered area.  The method is exact up to floating
point, and additive: several disjoint polygons can go into the same sum.

Source of the idea: signed-area accumulation as vector font rasterisers use it (M. Kilgard, J. Bolz and others; public
since LibArt, 1998).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Window", "cover"]

Points = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the pixel grid: columns ``left`` … left+width-1, rows ``top`` … top+height-1."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of an array that holds the whole grid."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    @classmethod
    def around(cls, contours: Iterable[Points], width: int, height: int, margin: int = 1) -> "Window | None":
        """Return the smallest window of a grid around contours, or None where nothing of them is on the grid."""
        points = np.concatenate([*contours, np.zeros((0, 2))])
        if len(points) == 0:
            return None
        low = np.floor(points.min(axis=0) + 0.5).astype(int) - margin
        high = np.floor(points.max(axis=0) + 0.5).astype(int) + margin
        left, top = max(int(low[0]), 0), max(int(low[1]), 0)
        right, bottom = min(int(high[0]), width - 1), min(int(high[1]), height - 1)
        if right < left or bottom < top:
            return None
        return cls(left, top, right - left + 1, bottom - top + 1)


def cover(contours: Iterable[Points], window: Window) -> npt.NDArray[np.float32]:
    """Return the covered share of each pixel of a window, shape (height, width) float32.

    Contours have shape (n, 2), columns u and v with pixel centres at whole numbers; outlines and holes turn in opposite
    directions.  Contours that turn the same way must not overlap.
    """
    start, step = _edges(contours, window)
    if len(start) == 0:
        return np.zeros((window.height, window.width), np.float32)
    begin, end = _pieces(start, step)
    rise = end[:, 1] - begin[:, 1]
    middle = (begin + end) * 0.5
    row = np.floor(middle[:, 1]).astype(np.int64)
    seen = (row >= 0) & (row < window.height) & (middle[:, 0] < window.width) & (rise != 0.0)
    rise, across, row = rise[seen], np.maximum(middle[seen, 0], 0.0), row[seen]
    column = np.floor(across).astype(np.int64)
    inside = rise * (across - column)  # what the piece leaves to the next pixels only
    stride = window.width + 1
    cell = row * stride + column
    total = np.bincount(cell, rise - inside, window.height * stride + 1)
    total += np.bincount(cell + 1, inside, window.height * stride + 1)
    sums = np.cumsum(total[:-1].reshape(window.height, stride), axis=1)[:, :-1]
    return np.abs(sums, dtype=np.float32, casting="same_kind")


def _edges(contours: Iterable[Points], window: Window) -> tuple[Points, Points]:
    """Return start and vector of every edge that may touch the window's rows, with pixel (0, 0) spanning 0 … 1."""
    corner = (window.left - 0.5, window.top - 0.5)
    moved = [np.asarray(contour, np.float64) - corner for contour in contours]
    if not moved:
        return np.zeros((0, 2)), np.zeros((0, 2))
    start = np.concatenate(moved)
    end = np.concatenate([np.roll(contour, -1, axis=0) for contour in moved])
    near = (np.maximum(start[:, 1], end[:, 1]) > 0) & (np.minimum(start[:, 1], end[:, 1]) < window.height)
    near &= np.minimum(start[:, 0], end[:, 0]) < window.width
    return start[near], (end - start)[near]


def _pieces(start: Points, step: Points) -> tuple[Points, Points]:
    """Return begin and end of the pieces into which pixel borders cut the edges."""
    count = len(start)
    owners, shares = [np.arange(count), np.arange(count)], [np.zeros(count), np.ones(count)]
    for axis in (0, 1):
        first = np.floor(np.minimum(start[:, axis], start[:, axis] + step[:, axis])).astype(np.int64) + 1
        last = np.ceil(np.maximum(start[:, axis], start[:, axis] + step[:, axis])).astype(np.int64) - 1
        crossings = np.maximum(last - first + 1, 0)
        owner = np.repeat(np.arange(count), crossings)
        rank = np.arange(len(owner)) - np.repeat(np.cumsum(crossings) - crossings, crossings)
        border = first[owner] + rank
        owners.append(owner)
        shares.append((border - start[owner, axis]) / step[owner, axis])
    owner, share = np.concatenate(owners), np.concatenate(shares)
    order = np.lexsort((share, owner))
    owner, share = owner[order], share[order]
    points = start[owner] + step[owner] * share[:, None]
    same = owner[1:] == owner[:-1]
    return points[:-1][same], points[1:][same]
