"""Which connected regions does a mask hold?  Their outlines in pixels, dust left out."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points

__all__ = ["RawBlob", "find_blobs"]

# More blobs than this are texture or noise: the largest are kept, and the description says so.
MAX_BLOBS = 1000
# Deviation in pixels that the polygon of an outline may have from the outline.
SIMPLIFY_PX = 1.1


@dataclass(frozen=True, slots=True, eq=False)
class RawBlob:
    """One connected region.

    ``polygon`` (n, 2): corners of its outline through the centres of its outermost pixels, u and v, clockwise or not.
    ``area_px``: area enclosed by the pixels' own borders.  ``touches_rim``: the picture's rim cuts it.
    """

    polygon: Points
    area_px: float
    touches_rim: bool


def find_blobs(mask: npt.NDArray[np.uint8], min_area_px: float) -> tuple[list[RawBlob], int]:
    """Return the blobs of at least this area, largest first, and how many smaller or superfluous ones were left out."""
    height, width = mask.shape
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    blobs: list[RawBlob] = []
    for contour in found:
        # An outline of n pixels encloses at most (n/4 + 1)² of them: this spares the area of every grain of noise.
        if (len(contour) / 4 + 1) ** 2 < min_area_px:
            continue
        area = float(cv2.contourArea(contour)) + 0.5 * len(contour) + 1.0
        if area < min_area_px:
            continue
        u, v, wide, high = cv2.boundingRect(contour)
        polygon = cv2.approxPolyDP(contour, SIMPLIFY_PX, closed=True).reshape(-1, 2).astype(np.float64)
        rim = u <= 0 or v <= 0 or u + wide >= width or v + high >= height
        blobs.append(RawBlob(polygon, area, rim))
    blobs.sort(key=lambda blob: -blob.area_px)
    kept = blobs[:MAX_BLOBS]
    return kept, len(found) - len(kept)
