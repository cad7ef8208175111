"""How are corners refined to a few hundredths of a pixel?  With windows of several widths; the best is chosen later.

Wide windows average noise away (measured against rendered truth: half side 3 px gives 0.041 px rms, 11 px 0.023 px),
but a window that reaches the next corner, or along which a strongly bent edge is not straight, is biased.  Which one
is best depends on board, lens and focus; so each corner is refined with several, and a calibration takes the width
that leaves the smallest residual over all views.

A wide window at the board's rim sometimes jumps to the rim, and a finger, a stain or a reflection takes a corner
along.  A corner that does not lie where all the others say is therefore looked for there with narrower windows, and
left out if it is not found.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points

__all__ = ["Found", "Grey", "refine_corners", "step_px"]

Grey = npt.NDArray[np.uint8]

SHARES = (0.42, 0.3, 0.2, 0.14)
"""Half side of the window, relative to the distance of the nearest two corners."""
MIN_WINDOW = 2
MAX_WINDOW = 15
# A corner is astray when it is off by this many pixels, and by this many times what corners are usually off.  (Of true
# corners under strong distortion and noise the worst is off by five times the median.)
ASTRAY_PX = 0.6
ASTRAY_SPREADS = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Numbers of the points on the board, and for each width of window (half side, px) their pixels (n, 2)."""

    indices: npt.NDArray[np.int64]
    variants: tuple[tuple[int, Points], ...]
    note: str = ""


def step_px(points_mm: Points, pixels: Points, pitch_mm: float) -> float:
    """Return the distance in the picture of the two nearest points that are neighbours on the board."""
    apart = np.linalg.norm(points_mm[:, None, :2] - points_mm[None, :, :2], axis=2)
    i, j = np.nonzero(np.triu(apart < 1.01 * pitch_mm, 1))
    if len(i) == 0:
        i, j = np.triu_indices(len(pixels), 1)
    return float(np.linalg.norm(pixels[i] - pixels[j], axis=1).min())


def refine_corners(
    grey: Grey, points_mm: Points, corners: Points, step: float, *, widest: float = 1.0
) -> tuple[npt.NDArray[np.int64], tuple[tuple[int, Points], ...]]:
    """Return which corners are kept, and those refined with windows of several widths, the widest first.

    ``points_mm`` (n, 3) on the board and ``corners`` (n, 2), good to a few pixels, belong together; ``step`` is the
    distance of neighbours in pixels, ``widest`` the largest half side allowed, relative to it.
    """
    windows = sorted(
        {int(np.clip(min(share, widest) * step, MIN_WINDOW, MAX_WINDOW)) for share in SHARES}, reverse=True
    )
    board = _cubic_terms(points_mm)
    start = corners
    kept = np.ones(len(corners), np.bool_)
    variants: list[Points] = []
    for number, window in enumerate(windows):
        # Each starts from the one before: a narrow window does not find a corner that is outside of it.
        found = _sub_pixel(grey, start, window)
        expected, limit = _expected(board, found)
        astray = np.hypot(*(found - expected).T) > limit
        for narrower in windows[number + 1 :]:
            if not astray.any():
                break
            found[astray] = _sub_pixel(grey, expected[astray], narrower)
            astray &= np.hypot(*(found - expected).T) > limit
        kept &= ~astray
        variants.append(found)
        start = np.where(astray[:, None], expected, found)
    return np.flatnonzero(kept).astype(np.int64), tuple(
        (window, found[kept]) for window, found in zip(windows, variants, strict=True)
    )


def _sub_pixel(grey: Grey, corners: Points, window: int) -> Points:
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-3)
    start = np.ascontiguousarray(corners.reshape(-1, 1, 2), dtype=np.float32)
    return np.asarray(cv2.cornerSubPix(grey, start, (window, window), (-1, -1), stop), np.float64).reshape(-1, 2)


def _cubic_terms(points_mm: Points) -> Points:
    """Return the products of up to three coordinates of each point, which any lens and tilt are smooth in."""
    middle, half = points_mm[:, :2].mean(axis=0), np.maximum(np.ptp(points_mm[:, :2], axis=0) / 2.0, 1e-9)
    x, y = ((points_mm[:, :2] - middle) / half).T
    terms = [x**i * y**j for i in range(4) for j in range(4 - i)]
    # Of few points only what they can bear.
    return np.column_stack(terms if len(points_mm) >= 2 * len(terms) else [np.ones_like(x), x, y, x * y])


def _expected(board: Points, found: Points) -> tuple[Points, float]:
    """Return where each corner is expected (n, 2) by all that agree, and by how much one may be off, in pixels."""
    good = np.ones(len(found), np.bool_)
    expected, limit = found, np.inf
    for _ in range(3):
        coefficients, *_ = np.linalg.lstsq(board[good], found[good], rcond=None)
        expected = np.asarray(board @ coefficients, np.float64)
        off = np.hypot(*(found - expected).T)
        limit = max(ASTRAY_PX, ASTRAY_SPREADS * float(np.median(off)))
        # What agrees best by three quarters is kept in any case: too little would leave the terms undetermined.
        good = off <= max(limit, float(np.sort(off)[len(off) * 3 // 4]))
    return expected, limit
