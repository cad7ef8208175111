"""What does the result say of blobs as such?  Their features, which ones the filters refuse, and the recipe's order.

Costs nothing where a recipe asks for none of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import BlobParameters
from slabcell.vision.blobs import Blobs
from slabcell.vision.features import BlobFeatures, fails, measure_blob, order_of
from slabcell.vision.outline import Rings
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PlaneView
from slabcell.vision.result import LocatedPart, RejectedBlob

__all__ = ["BlobReport", "report_blobs"]

# Where a segmentation cuts depends on its threshold; the edge is where the grey is half way.  It is looked for at so
# many points of each outline, so far on either side in pixels.
EDGE_POINTS: Final = 256
# OpenCV remaps no more rows at once.
REMAP_ROWS: Final = 32_000
EDGE_REACH_PX: Final = 4.0
EDGE_STEP_PX: Final = 0.5
# No point is moved farther than this from where most of the blob's points go.
EDGE_SPREAD_PX: Final = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class BlobReport:
    """``features`` of every blob, in the order of the blobs; ``filtered``: why blobs are refused by the filters."""

    parameters: BlobParameters
    plane: PlaneView
    features: tuple[BlobFeatures, ...]
    filtered: dict[int, str]

    def arrange(
        self, parts: Sequence[LocatedPart], rejected: Sequence[RejectedBlob]
    ) -> tuple[tuple[BlobFeatures, ...] | None, tuple[LocatedPart, ...], tuple[RejectedBlob, ...]]:
        """Return features, parts and refused blobs in the recipe's order; no features where it does not report them.

        A slab that was taken out of several that touch is sorted by the features of its own outline.
        """
        order = order_of(self.features, self.parameters)
        place: dict[int | None, int] = {old: new for new, old in enumerate(order)}
        new_parts = [part._replace(blob=place.get(part.blob)) for part in parts]
        new_rejected = [replace(blob, blob=place.get(blob.blob)) for blob in rejected]
        if self.parameters.sort_by is not None:
            new_parts = [new_parts[index] for index in order_of([self._of(part) for part in parts], self.parameters)]
            new_rejected = [
                new_rejected[index] for index in order_of([self._of(blob) for blob in rejected], self.parameters)
            ]
        features = tuple(self.features[index] for index in order) if self.parameters.report else None
        return features, tuple(new_parts), tuple(new_rejected)

    def _of(self, item: LocatedPart | RejectedBlob) -> BlobFeatures:
        if item.blob is not None:
            return self.features[item.blob]
        outline = self.plane.from_pixels(item.outline_px)
        return measure_blob(outline, item.outline_px, np.zeros((0, 0), np.uint8), self.plane, touches_border=False)


def report_blobs(
    blobs: Blobs, grey: Grey, mask: npt.NDArray[np.uint8], plane: PlaneView, parameters: BlobParameters
) -> BlobReport | None:
    """Return the features of the blobs and what the filters say, or None where the recipe asks for neither.

    ``grey`` (h, w): the picture, from which the outlines are made exact; ``mask`` (h, w): where the blobs were found,
    for their holes.
    """
    if not parameters.used:
        return None
    outlines = _at_the_edge(Rings.of([blob.polygon for blob in blobs]).counter_clockwise(), grey)
    features = tuple(
        measure_blob(
            plane.from_pixels(outlines[index]),
            blob.polygon,
            mask,
            plane,
            touches_border=blob.touches_rim,
        )
        for index, blob in enumerate(blobs)
    )
    filtered = {index: why for index, item in enumerate(features) if (why := fails(item, parameters.filters))}
    return BlobReport(parameters, plane, features, filtered)


def _at_the_edge(rings: Rings, grey: Grey) -> npt.NDArray[np.float64]:
    """Return (blobs, EDGE_POINTS, 2) points of each outline in pixels, where the grey is half way between both sides.

    On the rings where no edge is to be seen.
    """
    count = len(rings)
    points = rings.resampled(EDGE_POINTS)
    if count == 0:
        return points
    along = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    length = np.maximum(np.hypot(along[:, :, 0], along[:, :, 1]), 1e-9)
    outward = np.stack([along[:, :, 1], -along[:, :, 0]], axis=2) / length[:, :, None]
    steps = np.arange(-EDGE_REACH_PX, EDGE_REACH_PX + EDGE_STEP_PX, EDGE_STEP_PX)
    at = points[:, :, None, :] + steps[:, None] * outward[:, :, None, :]
    height, width = grey.shape
    seen = ((at >= 0) & (at <= (width - 1, height - 1))).all(axis=(2, 3))
    places = at.reshape(count * EDGE_POINTS, len(steps), 2).astype(np.float32)
    across: list[Any] = [
        cv2.remap(grey, np.ascontiguousarray(part[..., 0]), np.ascontiguousarray(part[..., 1]), cv2.INTER_LINEAR)
        for part in np.split(places, range(REMAP_ROWS, len(places), REMAP_ROWS))
    ]
    profile = np.concatenate(across).astype(np.float64).reshape(count, EDGE_POINTS, -1)
    inside, outside = profile[:, :, :3].mean(axis=2), profile[:, :, -3:].mean(axis=2)
    relative = (profile - outside[:, :, None]) / np.where(inside == outside, np.inf, inside - outside)[:, :, None]
    # The first place, from inside, at which the grey falls below one half.
    below = relative < 0.5
    first = np.argmax(below, axis=2)
    usable = seen & (inside != outside) & below.any(axis=2) & (first > 0)
    before = np.take_along_axis(relative, np.maximum(first - 1, 0)[:, :, None], axis=2)[:, :, 0]
    after = np.take_along_axis(relative, first[:, :, None], axis=2)[:, :, 0]
    share = (before - 0.5) / np.where(before > after, before - after, np.inf)
    found = steps[np.maximum(first - 1, 0)] + EDGE_STEP_PX * share
    usual = np.array([np.median(row[good]) if good.any() else 0.0 for row, good in zip(found, usable, strict=True)])
    distance = np.where(usable, found, usual[:, None])
    distance = np.clip(distance, usual[:, None] - EDGE_SPREAD_PX, usual[:, None] + EDGE_SPREAD_PX)
    # Of five neighbours the middle one: a speck of dirt on an edge is no part of the outline.
    distance = np.median([np.roll(distance, shift, axis=1) for shift in range(-2, 3)], axis=0)
    return points + distance[:, :, None] * outward
