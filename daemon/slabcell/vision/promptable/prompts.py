"""Where is a promptable model asked?  At coarse blobs: box and middle of each, and the thick places of large ones."""

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.blobs import Blobs
from slabcell.vision.promptable.model import Prompt

__all__ = ["prompts_of"]

# Thick places of one blob that are asked for, and how thin beside the thickest one may be.
MAX_PLACES: Final = 12
THINNEST: Final = 0.4
# The box stands off from the blob by this share of its size, because coarse blobs end too early as often as too late.
MARGIN: Final = 0.03


def prompts_of(mask: npt.NDArray[np.uint8], blobs: Blobs, largest_px: float, most: int) -> list[tuple[int, Prompt]]:
    """Return at most ``most`` prompts, each with the index of its blob, largest blobs first.

    ``largest_px``: area of the largest slab.  A larger blob is several slabs, or slabs with a shadow: each of its thick
    places is asked for alone.
    """
    found: list[tuple[int, Prompt]] = []
    for index, blob in enumerate(blobs):
        if len(found) >= most:
            break
        low = np.floor(blob.polygon.min(axis=0)).astype(int)
        high = np.ceil(blob.polygon.max(axis=0)).astype(int)
        several = blob.area_px > largest_px
        places = _thick_places(mask, low, high, MAX_PLACES if several else 1)
        if several:
            found += [(index, Prompt(place[None])) for place in places]
        else:
            margin = MARGIN * (high - low)
            (left, top), (right, bottom) = low - margin, high + margin
            box = (
                max(float(left), 0.0),
                max(float(top), 0.0),
                min(float(right), mask.shape[1] - 1.0),
                min(float(bottom), mask.shape[0] - 1.0),
            )
            found.append((index, Prompt(places[:1], box)))
    return found[:most]


def _thick_places(
    mask: npt.NDArray[np.uint8], low: npt.NDArray[np.int_], high: npt.NDArray[np.int_], most: int
) -> Points:
    """Return the pixels farthest from the mask's edge in a window, thickest first, each with a neighbourhood."""
    left, top = int(low[0]), int(low[1])
    window = mask[top : int(high[1]) + 1, left : int(high[0]) + 1]
    # A rim of table, so that what the window cuts has an edge there.
    depth = cv2.distanceTransform(cv2.copyMakeBorder(window, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0), cv2.DIST_L2, 5)
    places: list[tuple[float, float]] = []
    thickest = float(depth.max())
    while len(places) < most:
        _, value, _, place = cv2.minMaxLoc(depth)
        if value <= 0.0 or value < THINNEST * thickest:
            break
        places.append((float(place[0] - 1 + left), float(place[1] - 1 + top)))
        cv2.circle(depth, (int(place[0]), int(place[1])), round(1.5 * value), 0.0, cv2.FILLED)
    return np.array(places or [((low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0)], np.float64)
