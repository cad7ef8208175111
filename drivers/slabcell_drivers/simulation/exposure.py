"""How do sharp areas become blurred pixels?  Composed on a finer grid, blurred, averaged over each pixel, and added.

Brightness is additive, so each object is composed by itself in a window of its own, as its difference from what it
covers.  The fine grid makes the sampled Gaussian blur accurate: an edge along the pixel grid, the worst case, is less
than 2e-4 px from where it should be at a blur of 0.8 px.
"""

import math
from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from slabcell_drivers.simulation.coverage import Window, cover

__all__ = ["FINE", "add_blurred", "cover_fine", "cover_part", "fine_window"]

FINE = 4  # sub-pixels per pixel and axis

Field = npt.NDArray[np.float32]
Points = npt.NDArray[np.float64]


def fine_window(contours: Iterable[Points], width: int, height: int, blur_sigma_px: float) -> Window | None:
    """Return the window, in whole pixels, that the blurred picture of contours can reach; None if it is out of view.

    Contours are in pixels of the fine grid.  The window may overhang the picture by the reach of the blur.
    """
    points = np.concatenate([*contours, np.zeros((0, 2))])
    if len(points) == 0:
        return None
    reach = math.ceil(4.5 * blur_sigma_px) + 1
    low = np.floor((points.min(axis=0) + 0.5) / FINE).astype(int) - reach
    high = np.floor((points.max(axis=0) + 0.5) / FINE).astype(int) + reach
    left, top = max(int(low[0]), -reach), max(int(low[1]), -reach)
    right, bottom = min(int(high[0]), width - 1 + reach), min(int(high[1]), height - 1 + reach)
    if right < left or bottom < top:
        return None
    return Window(left, top, right - left + 1, bottom - top + 1)


def cover_fine(contours: Iterable[Points], window: Window) -> Field:
    """Return the covered share of each sub-pixel of a window, shape (FINE·height, FINE·width)."""
    return cover(contours, Window(window.left * FINE, window.top * FINE, window.width * FINE, window.height * FINE))


def cover_part(contours: Sequence[Points], window: Window) -> tuple[Window, Field]:
    """Return the part of a window's fine grid that contours reach, counted from the window's corner, and its shares."""
    corner = (window.left * FINE, window.top * FINE)
    moved = [contour - corner for contour in contours]
    part = Window.around(moved, window.width * FINE, window.height * FINE)
    if part is None:
        return Window(0, 0, 0, 0), np.zeros((0, 0), np.float32)
    return part, cover(moved, part)


def add_blurred(image: Field, window: Window, fine: Field, blur_sigma_px: float) -> None:
    """Add what a lens makes of a brightness on a window's fine grid to the picture, shape (height, width).

    ``fine`` is blurred in place.
    """
    if blur_sigma_px > 0:
        cv2.GaussianBlur(fine, (0, 0), blur_sigma_px * FINE, dst=fine, borderType=cv2.BORDER_CONSTANT)
    coarse = np.asarray(cv2.resize(fine, (window.width, window.height), interpolation=cv2.INTER_AREA), np.float32)
    height, width = image.shape
    top, left = max(window.top, 0), max(window.left, 0)
    bottom, right = min(window.top + window.height, height), min(window.left + window.width, width)
    if bottom > top and right > left:
        image[top:bottom, left:right] += coarse[
            top - window.top : bottom - window.top, left - window.left : right - window.left
        ]
