"""Which pixels belong to slabs?  One of several methods, chosen by the recipe or by the picture.

Every method returns a mask and says in words what it did.  A picture without two populations of grey (blank, white,
noise alone) gives an empty mask.  The edge itself is measured later on the raw pixels, so a threshold needs to be right
only to a pixel or two.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import SegmentationParameters
from slabcell.vision.clustering import cluster
from slabcell.vision.morphology import apply_morphology
from slabcell.vision.pixels import Grey, as_8_bit
from slabcell.vision.thresholds import (
    DARK_OFFSET,
    Split,
    dynamic_range,
    estimate_noise,
    histogram_of,
    several_levels,
    split_in_two,
)

__all__ = ["Segmentation", "segment"]

Mask = npt.NDArray[np.uint8]

# The histogram is made of every SUBSAMPLE-th pixel in both directions.
SUBSAMPLE = 4
# Two populations are told apart when their means differ by this many standard deviations of the pixel noise ...
MIN_CONTRAST_SIGMA = 6.0
# ... and by this many of 255 grey levels.
MIN_CONTRAST = 8.0
# Share of the smaller population that may lie half way between the two before the light counts as uneven.
MAX_VALLEY_SHARE = 0.10
# The local threshold follows the light on a picture reduced by this factor.
REDUCTION = 8


@dataclass(frozen=True, slots=True, eq=False)
class Segmentation:
    """``mask`` is 255 on slabs and 0 elsewhere, shape (h, w); ``description`` says how it came about.

    ``picture``: what was looked at, 8 bits; ``contrast``: difference of its two populations of grey, 0 where there is
    one only.
    """

    mask: Mask
    description: str
    picture: Mask
    contrast: float


def segment(grey: Grey, parameters: SegmentationParameters, image: npt.NDArray[Any] | None = None) -> Segmentation:
    """Return the mask of the slabs in a grey picture; ``image`` is the same picture in colour, if there is one.

    For method promptable it is the mask that the prompts come from.
    """
    if parameters.method == "promptable" and parameters.promptable is not None:
        parameters = parameters.model_copy(update={"method": parameters.promptable.coarse})
    picture = as_8_bit(grey)
    sample = picture[::SUBSAMPLE, ::SUBSAMPLE]
    histogram = histogram_of(sample)
    split = split_in_two(histogram)
    contrast = 0.0 if split is None else split.light - split.dark
    if parameters.method == "kmeans":
        colour = image is not None and image.ndim == 3 and image.dtype == np.uint8
        mask, text = cluster(image if colour and image is not None else picture, parameters.classes)
        return _finish(mask, text, picture, contrast, light=True, parameters=parameters)
    if parameters.method == "fixed" and parameters.threshold is not None:
        mask = (grey > parameters.threshold).astype(np.uint8) * np.uint8(255)
        light = _slabs_are_light(mask[::SUBSAMPLE, ::SUBSAMPLE], 127.0, parameters.polarity)
        return _finish(
            mask, f"fixed threshold {parameters.threshold}", picture, contrast, light=light, parameters=parameters
        )
    noise = estimate_noise(sample)
    needed = max(MIN_CONTRAST, MIN_CONTRAST_SIGMA * noise)
    if split is None or contrast < needed:
        return Segmentation(
            np.zeros_like(picture),
            f"no slabs: light and dark differ by {contrast:.1f} of 255 grey levels, {needed:.1f} are needed"
            f" (noise {noise:.1f})",
            picture,
            0.0,
        )
    light = _slabs_are_light(sample, split.level, parameters.polarity)
    mask, text = _threshold(picture, histogram, split, parameters, light=light)
    text = f"{text}; slabs are {'light' if light else 'dark'}"
    return _finish(mask, text, picture, contrast, light=light, parameters=parameters)


def _threshold(
    picture: Mask,
    histogram: npt.NDArray[np.float64],
    split: Split,
    parameters: SegmentationParameters,
    *,
    light: bool,
) -> tuple[Mask, str]:
    """Return where the picture is light, and what was done."""
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
        return _lighter(picture, level), f"dynamic threshold {level:.0f}, range {low:.0f} ... {high:.0f}"
    if method == "multi_otsu":
        levels = several_levels(histogram, parameters.classes)
        index = len(levels) - parameters.slab_classes if light else parameters.slab_classes - 1
        shown = ", ".join(f"{level:.0f}" for level in levels)
        return _lighter(picture, levels[index]), f"multi_otsu levels {shown}, slabs beyond {levels[index]:.0f}"
    return _lighter(picture, split.level), f"otsu threshold {split.level:.0f} of 255{why}"


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


def _slabs_are_light(sample: Mask, level: float, polarity: str) -> bool:
    if polarity != "auto":
        return polarity == "light"
    rim = np.concatenate([sample[0], sample[-1], sample[:, 0], sample[:, -1]])
    return bool(np.mean(rim > level) <= 0.5)


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


def _finish(
    mask: Mask, description: str, picture: Mask, contrast: float, *, light: bool, parameters: SegmentationParameters
) -> Segmentation:
    found = mask if light else _as_mask(cv2.bitwise_not(mask))
    if parameters.roi is not None:
        inside = np.zeros_like(found)
        corners = np.clip(np.rint(parameters.roi), -32000, 32000).astype(np.int32)
        cv2.fillPoly(inside, [corners], 255)
        found = _as_mask(cv2.bitwise_and(found, inside))
    return Segmentation(apply_morphology(found, parameters.morphology), description, picture, contrast)
