"""Which pixels belong to slabs?  A threshold over the whole picture or one that follows the light.

Every method returns a mask and says in words what it did.  A picture without two populations of grey (blank, white,
noise alone) gives an empty mask.  The edge itself is measured later on the raw pixels, so a threshold needs to be right
only to a pixel or two.

Source of the threshold: N. Otsu, "A threshold selection method from gray-level histograms", IEEE SMC 9(1), 1979; here
on the logarithm of the grey level, because light multiplies.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import SegmentationParameters
from slabcell.vision.pixels import Grey, as_8_bit

__all__ = ["Segmentation", "segment"]

Mask = npt.NDArray[np.uint8]
Levels = npt.NDArray[np.float64]

# Added before the logarithm, in grey levels: below it the picture is noise, not reflectance.
DARK_OFFSET = 8.0
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
    """``mask`` is 255 on slabs and 0 elsewhere, shape (h, w); ``description`` says how it came about."""

    mask: Mask
    description: str


@dataclass(frozen=True, slots=True)
class _Split:
    """Two populations of grey: the level between them, their means, and the share of pixels in the valley."""

    level: float
    dark: float
    light: float
    valley_share: float
    light_share: float


def segment(grey: Grey, parameters: SegmentationParameters) -> Segmentation:
    """Return the mask of the slabs in a grey picture."""
    picture = as_8_bit(grey)
    sample = picture[::SUBSAMPLE, ::SUBSAMPLE]
    if parameters.method == "fixed" and parameters.threshold is not None:
        mask = (grey > parameters.threshold).astype(np.uint8) * 255
        light = _slabs_are_light(mask[::SUBSAMPLE, ::SUBSAMPLE], 127.0, parameters.polarity)
        return _finish(mask, f"fixed threshold {parameters.threshold}", light=light, parameters=parameters)
    split = _split(sample)
    noise = _noise(sample)
    needed = max(MIN_CONTRAST, MIN_CONTRAST_SIGMA * noise)
    if split is None or split.light - split.dark < needed:
        found = 0.0 if split is None else split.light - split.dark
        return Segmentation(
            np.zeros_like(picture),
            f"no slabs: light and dark differ by {found:.1f} of 255 grey levels, {needed:.1f} are needed"
            f" (noise {noise:.1f})",
        )
    light = _slabs_are_light(sample, split.level, parameters.polarity)
    method = parameters.method
    why = ""
    if method in ("auto", "fixed"):
        even = split.valley_share <= MAX_VALLEY_SHARE
        method = "otsu" if even else "local"
        why = f", chosen because {100 * split.valley_share:.1f} % of the smaller population lies between the two"
    if method == "otsu":
        _, mask = cv2.threshold(picture, split.level, 255, cv2.THRESH_BINARY)
        return _finish(
            np.asarray(mask, np.uint8),
            f"otsu threshold {split.level:.0f} of 255{why}",
            light=light,
            parameters=parameters,
        )
    mask = _local(picture, split, light=light)
    return _finish(mask, f"local threshold{why}", light=light, parameters=parameters)


def _split(sample: Mask) -> _Split | None:
    histogram = _histogram(sample)
    values = np.log(np.arange(256) + DARK_OFFSET)
    weight = np.cumsum(histogram)
    moment = np.cumsum(histogram * values)
    below, above = weight[:-1], weight[-1] - weight[:-1]
    usable = (below > 0) & (above > 0)
    if not np.any(usable):
        return None
    mean_below = moment[:-1] / np.maximum(below, 1)
    mean_above = (moment[-1] - moment[:-1]) / np.maximum(above, 1)
    between = np.where(usable, below * above * (mean_above - mean_below) ** 2, 0.0)
    # Between two populations with a gap the criterion is flat: take the middle of the plateau.
    best = np.flatnonzero(between >= between.max() * (1 - 1e-9))
    cut = int(best[len(best) // 2])
    low, high = mean_below[cut], mean_above[cut]
    between_both = (values > low + 0.35 * (high - low)) & (values < low + 0.65 * (high - low))
    smaller = min(below[cut], above[cut])
    return _Split(
        level=cut + 0.5,
        dark=float(np.exp(low) - DARK_OFFSET),
        light=float(np.exp(high) - DARK_OFFSET),
        valley_share=float(histogram[between_both].sum() / smaller),
        light_share=float(above[cut] / weight[-1]),
    )


def _histogram(sample: Mask) -> Levels:
    return cv2.calcHist([sample], [0], None, [256], [0, 256]).reshape(-1).astype(np.float64)


def _noise(sample: Mask) -> float:
    """Return the standard deviation of the pixel noise, from differences of neighbours, which edges barely touch."""
    if sample.shape[1] < 3:
        return 0.0
    steps = cv2.absdiff(sample[::2, 1:], sample[::2, :-1])
    counts = _histogram(_as_mask(steps))
    # The median of |N(0, s√2)| is 0.954 s; interpolated within its grey level.
    half = 0.5 * float(counts.sum())
    cumulative = np.cumsum(counts)
    bin_index = int(np.count_nonzero(cumulative < half))
    before = float(cumulative[bin_index - 1]) if bin_index else 0.0
    median = max(0.0, bin_index - 0.5 + (half - before) / max(float(counts[bin_index]), 1.0))
    return median / 0.954


def _slabs_are_light(sample: Mask, level: float, polarity: str) -> bool:
    if polarity != "auto":
        return polarity == "light"
    rim = np.concatenate([sample[0], sample[-1], sample[:, 0], sample[:, -1]])
    return bool(np.mean(rim > level) <= 0.5)


def _local(picture: Mask, split: _Split, *, light: bool) -> Mask:
    """Return where the picture is lighter than a threshold that follows the light on the table."""
    height, width = picture.shape
    small = cv2.resize(
        picture, (max(width // REDUCTION, 1), max(height // REDUCTION, 1)), interpolation=cv2.INTER_AREA
    ).astype(np.float32)
    small += DARK_OFFSET
    ratio = (split.light + DARK_OFFSET) / (split.dark + DARK_OFFSET)
    table = (split.dark if light else split.light) + DARK_OFFSET
    limit = np.full_like(small, split.level + DARK_OFFSET)
    window = max(3, min(small.shape) // 3) | 1
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


def _finish(mask: Mask, description: str, *, light: bool, parameters: SegmentationParameters) -> Segmentation:
    found = mask if light else _as_mask(cv2.bitwise_not(mask))
    if parameters.roi is not None:
        inside = np.zeros_like(found)
        corners = np.clip(np.rint(parameters.roi), -32000, 32000).astype(np.int32)
        cv2.fillPoly(inside, [corners], 255)
        found = _as_mask(cv2.bitwise_and(found, inside))
    return Segmentation(found, f"{description}; slabs are {'light' if light else 'dark'}")
