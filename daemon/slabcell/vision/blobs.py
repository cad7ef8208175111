"""Which regions of a picture may be slabs?  Their outlines in pixels, dust left out."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.contours import Contours
from slabcell.vision.kernel import engine

__all__ = ["Blobs", "RawBlob", "find_blobs"]

Index = npt.NDArray[np.int64]

# More blobs than this are texture or noise: the largest are kept, and the description says so.
MAX_BLOBS = 1000
# Deviation in pixels that the polygon of an outline may have from the outline.
SIMPLIFY_PX = 1.1


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


class Blobs:
    """The regions of one picture, with their outlines in one array; a `RawBlob` is made of those that are asked for.

    ``points`` (n, 2): u and v of all outlines; that of blob i is ``begins[i]`` to ``ends[i]``.  ``area_px`` and
    ``touches_rim`` as in `RawBlob`.
    """

    def __init__(
        self, points: Points, begins: Index, ends: Index, area_px: Sequence[float], touches_rim: Sequence[bool]
    ) -> None:
        self.points, self.begins, self.ends = points, begins, ends
        self.area_px, self.touches_rim = area_px, touches_rim
        self._made: dict[int, RawBlob] = {}

    @classmethod
    def of(cls, blobs: Sequence[RawBlob]) -> Self:
        """Return these blobs together."""
        ends = np.cumsum([len(blob.outline) for blob in blobs], dtype=np.int64)
        points = np.concatenate([*(blob.outline for blob in blobs), np.zeros((0, 2))])
        made = cls(
            points,
            ends - np.array([len(blob.outline) for blob in blobs], np.int64),
            ends,
            [blob.area_px for blob in blobs],
            [blob.touches_rim for blob in blobs],
        )
        made._made = dict(enumerate(blobs))
        return made

    @classmethod
    def of_contours(cls, contours: Contours) -> tuple[Self, int]:
        """Return the blobs of these outlines, largest first, and how many were left out."""
        areas, rims, starts = contours.area_px.tolist(), contours.touches_rim.tolist(), contours.starts.tolist()
        order = sorted(range(len(areas)), key=areas.__getitem__, reverse=True)[:MAX_BLOBS]
        blobs = cls(
            contours.points,
            np.array([starts[index] for index in order], np.int64),
            np.array([starts[index + 1] for index in order], np.int64),
            [areas[index] for index in order],
            [rims[index] for index in order],
        )
        return blobs, contours.left_out + len(contours) - len(blobs)

    def __len__(self) -> int:
        return len(self.area_px)

    def __getitem__(self, index: int) -> RawBlob:
        made = self._made.get(index)
        if made is None:
            outline = self.points[self.begins[index] : self.ends[index]]
            made = self._made[index] = RawBlob(outline, self.area_px[index], self.touches_rim[index])
        return made

    def __iter__(self) -> Iterator[RawBlob]:
        return (self[index] for index in range(len(self)))


def find_blobs(mask: npt.NDArray[np.uint8], min_area_px: float) -> tuple[Blobs, int]:
    """Return the blobs of a mask of at least this area, largest first, and how many others were left out."""
    contours = engine().trace(mask, 127.0, dark=False, interpolate=False, min_area_px=min_area_px)
    blobs, left_out = Blobs.of_contours(contours)
    # A mask's outline is a staircase, which is longer where it runs aslant: its simplified polygon is not.
    return Blobs.of([RawBlob(blob.polygon, blob.area_px, blob.touches_rim) for blob in blobs]), left_out
