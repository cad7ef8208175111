"""Which regions of a picture may be slabs?  Their outlines in pixels, dust left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.contours import Contours
from slabcell.vision.kernel import engine

__all__ = ["RawBlob", "blobs_of", "find_blobs", "rings_of"]

# More blobs than this are texture or noise: the largest are kept, and the description says so.
MAX_BLOBS = 1000
# Deviation in pixels that the polygon of an outline may have from the outline.
SIMPLIFY_PX = 1.1
# Points of an outline that are enough to describe it.
ENOUGH = 400


@dataclass(frozen=True, eq=False)
class RawBlob:
    """One connected region.

    ``outline`` (n, 2): points of its border, u and v, all around.  ``area_px``: area that it encloses.
    ``touches_rim``: the picture's rim cuts it.
    """

    outline: Points
    area_px: float
    touches_rim: bool

    @cached_property
    def polygon(self) -> Points:
        """Corners of the outline, simplified to about a pixel, shape (n, 2)."""
        if len(self.outline) < 3:
            return self.outline
        corners = cv2.approxPolyDP(self.outline.astype(np.float32).reshape(-1, 1, 2), SIMPLIFY_PX, closed=True)
        return corners.reshape(-1, 2).astype(np.float64)


def find_blobs(mask: npt.NDArray[np.uint8], min_area_px: float) -> tuple[list[RawBlob], int]:
    """Return the blobs of a mask of at least this area, largest first, and how many others were left out."""
    blobs, left_out = blobs_of(engine().trace(mask, 127.0, dark=False, interpolate=False, min_area_px=min_area_px))
    # A mask's outline is a staircase, which is longer where it runs aslant: its simplified polygon is not.
    return [RawBlob(blob.polygon, blob.area_px, blob.touches_rim) for blob in blobs], left_out


def blobs_of(contours: Contours) -> tuple[list[RawBlob], int]:
    """Return the blobs of these outlines, largest first, and how many were left out."""
    order = np.argsort(-contours.area_px, kind="stable")[:MAX_BLOBS].tolist()
    starts, areas, rims = contours.starts.tolist(), contours.area_px.tolist(), contours.touches_rim.tolist()
    blobs = [RawBlob(contours.points[starts[at] : starts[at + 1]], areas[at], rims[at]) for at in order]
    return blobs, contours.left_out + len(contours) - len(blobs)


def rings_of(blobs: Sequence[RawBlob]) -> tuple[Points, npt.NDArray[np.int64]]:
    """Return the outlines of all blobs one after the other, and where each begins, (blobs + 1,).

    Of long outlines every second or third point, so that ENOUGH are left.
    """
    outlines = [blob.outline[:: max(1, len(blob.outline) // ENOUGH)] for blob in blobs]
    starts = np.zeros(len(blobs) + 1, np.int64)
    np.cumsum([len(outline) for outline in outlines], out=starts[1:])
    return np.concatenate([*outlines, np.zeros((0, 2))]), starts
