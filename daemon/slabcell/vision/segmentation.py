"""Which pixels belong to slabs?  One of several methods, chosen by the recipe or by the picture.

Every method returns a mask and says in words what it did.  A picture without two populations of grey (blank, white,
noise alone) gives an empty mask.  The edge itself is measured later on the raw pixels, so a threshold needs to be right
only to a pixel or two.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import SegmentationParameters
from slabcell.vision.blobs import Blobs, find_blobs
from slabcell.vision.clustering import cluster
from slabcell.vision.kernel import engine
from slabcell.vision.morphology import apply_morphology
from slabcell.vision.pixels import Grey, as_8_bit
from slabcell.vision.survey import Survey, rim_of
from slabcell.vision.thresholds import DARK_OFFSET, Split, dynamic_range, several_levels

__all__ = ["Segmentation", "segment"]

Mask = npt.NDArray[np.uint8]

# Two populations are told apart when their means differ by this many standard deviations of the pixel noise ...
MIN_CONTRAST_SIGMA = 6.0
# ... and by this many of 255 grey levels.
MIN_CONTRAST = 8.0
# A picture too noisy for that is looked at smoothed by a Gaussian of this width.
SMOOTH_PX = 2.0
# Share of the smaller population that may lie half way between the two before the light counts as uneven.
MAX_VALLEY_SHARE = 0.10
# The local threshold follows the light on a picture reduced by this factor.
REDUCTION = 8
# No pixel of 8 bits is above this level.
NOTHING = 255.0


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Which pixels belong to slabs; ``description`` says how that came about.

    ``picture``: what was looked at, 8 bits; ``contrast``: difference of its two populations of grey, 0 where there is
    one only.  ``level``: the grey level that alone parts slabs from table, ``light`` on which side the slabs are; None
    where the mask was made in another way.
    """

    description: str
    picture: Mask
    contrast: float
    level: float | None = None
    light: bool = True
    made: Mask | None = field(default=None, repr=False)

    @cached_property
    def mask(self) -> Mask:
        """255 on slabs and 0 elsewhere, shape (h, w)."""
        if self.made is not None:
            return self.made
        kind = cv2.THRESH_BINARY if self.light else cv2.THRESH_BINARY_INV
        return _as_mask(cv2.threshold(self.picture, NOTHING if self.level is None else self.level, 255, kind)[1])

    def blobs(self, min_area_px: float, row_shift: int = 0) -> tuple[Blobs, int]:
        """Return the blobs of at least this area, largest first, and how many others were left out.

        Where one level parts slabs from table their outlines are known to a fraction of a pixel, and only every
        2^row_shift-th row of the picture is searched for them.
        """
        if self.level is None:
            return find_blobs(self.mask, min_area_px)
        contours = engine().trace(
            *(self.picture, self.level),
            dark=not self.light,
            interpolate=True,
            min_area_px=min_area_px,
            row_shift=row_shift,
        )
        return Blobs.of_contours(contours)


def segment(
    grey: Grey,
    parameters: SegmentationParameters,
    image: npt.NDArray[Any] | None = None,
    *,
    surveyed: Survey | None = None,
) -> Segmentation:
    """Return which pixels of a grey picture are slabs.

    ``image`` is the same picture in colour, if there is one; ``surveyed`` its survey with 8 bits, if it was made
    already.  For method promptable it is what the prompts come from.
    """
    if parameters.method == "promptable" and parameters.promptable is not None:
        parameters = parameters.model_copy(update={"method": parameters.promptable.coarse})
    picture = as_8_bit(grey)
    if surveyed is None:
        surveyed = engine().survey(picture)
    histogram = surveyed.grey
    split = surveyed.split
    contrast = 0.0 if split is None else split.light - split.dark
    if parameters.method == "kmeans":
        colour = image is not None and image.ndim == 3 and image.dtype == np.uint8
        mask, text = cluster(image if colour and image is not None else picture, parameters.classes)
        return _finish(Segmentation(text, picture, contrast, made=mask), parameters)
    if parameters.method == "fixed" and parameters.threshold is not None:
        text, threshold = f"fixed threshold {parameters.threshold}", parameters.threshold
        if grey.dtype == np.uint8:
            light = _slabs_are_light(surveyed.rim, threshold + 0.5, parameters.polarity)
            return _finish(Segmentation(text, picture, contrast, min(threshold + 0.5, NOTHING), light), parameters)
        above = (grey > threshold).astype(np.uint8) * np.uint8(255)
        light = _slabs_are_light(rim_of(above), 127.0, parameters.polarity)
        return _finish(Segmentation(text, picture, contrast, light=light, made=_side(above, light=light)), parameters)
    needed, smoothed = _needed(surveyed.noise), ""
    if split is not None and contrast < needed and contrast >= MIN_CONTRAST:
        # Too noisy pixel by pixel: the outline is found where neighbours agree, the edges are measured as they are.
        smooth = _as_mask(cv2.GaussianBlur(picture, (0, 0), SMOOTH_PX))
        again = engine().survey(smooth)
        if again.split is not None and again.split.light - again.split.dark >= _needed(again.noise):
            smoothed = f"found in the picture smoothed over {SMOOTH_PX:g} px, because its noise is {surveyed.noise:.1f}"
            picture, surveyed, split, histogram = smooth, again, again.split, again.grey
            contrast, needed = split.light - split.dark, _needed(again.noise)
    if split is None or contrast < needed:
        text = f"no slabs: light and dark differ by {contrast:.1f} of 255 grey levels, {needed:.1f} are needed"
        return Segmentation(f"{text} (noise {surveyed.noise:.1f})", picture, 0.0, NOTHING)
    light = _slabs_are_light(surveyed.rim, split.level, parameters.polarity)
    found, text = _threshold(picture, histogram, split, parameters, light=light)
    text = "; ".join(filter(None, (text, smoothed, "slabs are light" if light else "slabs are dark")))
    if isinstance(found, np.ndarray):
        return _finish(Segmentation(text, picture, contrast, light=light, made=_side(found, light=light)), parameters)
    return _finish(Segmentation(text, picture, contrast, found, light), parameters)


def _needed(noise: float) -> float:
    """Return by how many grey levels light and dark must differ in a picture of so much noise."""
    return max(MIN_CONTRAST, MIN_CONTRAST_SIGMA * noise)


def _threshold(
    picture: Mask,
    histogram: npt.NDArray[np.int64],
    split: Split,
    parameters: SegmentationParameters,
    *,
    light: bool,
) -> tuple[Mask | float, str]:
    """Return the level above which the picture is light, or where it is, and what was done."""
    method, why = parameters.method, ""
    if method == "auto":
        method = "otsu" if split.valley_share <= MAX_VALLEY_SHARE else "local"
        why = f", chosen because {100 * split.valley_share:.1f} % of the smaller population lies between the two"
    if method == "local":
        return _local(picture, split, parameters.window_px, light=light), f"local threshold{why}"
    if method in ("dynamic_hard", "dynamic_soft"):
        low, high = dynamic_range(histogram, parameters.low_tail_percent, parameters.high_tail_percent)
        level = low + (high - low) * parameters.level_percent / 100.0
        if method == "dynamic_soft":
            half = max(0.5, 0.5 * (high - low) * parameters.softness_percent / 100.0)
            return _soft(
                picture, level - half, level + half
            ), f"soft threshold {level - half:.0f} ... {level + half:.0f}"
        return level, f"dynamic threshold {level:.0f}, range {low:.0f} ... {high:.0f}"
    if method == "multi_otsu":
        levels = several_levels(histogram, parameters.classes)
        index = len(levels) - parameters.slab_classes if light else parameters.slab_classes - 1
        shown = ", ".join(f"{level:.0f}" for level in levels)
        return levels[index], f"multi_otsu levels {shown}, slabs beyond {levels[index]:.0f}"
    return split.level, f"otsu threshold {split.level:.0f} of 255{why}"


def _lighter(picture: Mask, level: float) -> Mask:
    _, mask = cv2.threshold(picture, level, 255, cv2.THRESH_BINARY)
    return _as_mask(mask)


def _soft(picture: Mask, low: float, high: float) -> Mask:
    """Return where a pixel and its neighbours together belong to the light ones by more than half.

    The membership of a pixel rises from 0 at ``low`` to 1 at ``high``.
    """
    membership = np.clip((np.arange(256) - low) / (high - low), 0.0, 1.0) * 255.0
    lifted = cv2.LUT(picture, np.rint(membership).astype(np.uint8))
    return _lighter(_as_mask(cv2.GaussianBlur(lifted, (3, 3), 0)), 127.5)


def _slabs_are_light(rim: npt.NDArray[np.int64], level: float, polarity: str) -> bool:
    """Return whether the slabs are what is lighter: the rim of a picture mostly shows the table.

    ``rim`` (256,): how many of its pixels have each level.
    """
    if polarity != "auto":
        return polarity == "light"
    return 2 * int(rim[math.floor(level) + 1 :].sum()) <= int(rim.sum())


def _side(above: Mask, *, light: bool) -> Mask:
    return above if light else _as_mask(cv2.bitwise_not(above))


def _local(picture: Mask, split: Split, window_px: int, *, light: bool) -> Mask:
    """Return where the picture is lighter than a threshold that follows the light on the table."""
    height, width = picture.shape
    small = cv2.resize(
        picture, (max(width // REDUCTION, 1), max(height // REDUCTION, 1)), interpolation=cv2.INTER_AREA
    ).astype(np.float32)
    small += DARK_OFFSET
    ratio = (split.light + DARK_OFFSET) / (split.dark + DARK_OFFSET)
    table = (split.dark if light else split.light) + DARK_OFFSET
    limit = np.full_like(small, split.level + DARK_OFFSET)
    window = max(3, window_px // REDUCTION if window_px else min(small.shape) // 3) | 1
    # The first pass uses one level everywhere; each further pass knows the table's light better.
    for _ in range(3):
        background = (small < limit if light else small > limit).astype(np.float32)
        share = cv2.blur(background, (window, window), borderType=cv2.BORDER_REFLECT)
        level = cv2.blur(background * small, (window, window), borderType=cv2.BORDER_REFLECT)
        level = np.where(share > 0.02, level / np.maximum(share, 0.02), table).astype(np.float32)
        limit = level * np.float32(np.sqrt(ratio) if light else 1.0 / np.sqrt(ratio))
    threshold = np.clip(cv2.resize(limit, (width, height), interpolation=cv2.INTER_LINEAR) - DARK_OFFSET, 0, 255)
    return _as_mask(cv2.compare(picture, _as_mask(threshold), cv2.CMP_GT))


def _as_mask(picture: npt.NDArray[Any]) -> Mask:
    """Give the name of their type back to arrays that OpenCV returns without."""
    return picture.astype(np.uint8, copy=False)


def _finish(found: Segmentation, parameters: SegmentationParameters) -> Segmentation:
    """Return the segmentation after region of interest and morphology, where the recipe has them."""
    if parameters.roi is None and not parameters.morphology:
        return found
    mask = found.mask
    if parameters.roi is not None:
        inside = np.zeros_like(mask)
        corners = np.clip(np.rint(parameters.roi), -32000, 32000).astype(np.int32)
        cv2.fillPoly(inside, [corners], 255)
        mask = _as_mask(cv2.bitwise_and(mask, inside))
    made = apply_morphology(mask, parameters.morphology)
    return Segmentation(found.description, found.picture, found.contrast, light=found.light, made=made)
