"""How many pixels have which grey, and where do the parameters cut?  For a person who moves the thresholds."""

from __future__ import annotations

import numpy as np

from slabcell.images import Image
from slabcell.recipe import SegmentationParameters
from slabcell.vision.pixels import as_8_bit, as_grey
from slabcell.vision.segmentation import segment
from slabcell.vision.thresholds import dynamic_range

__all__ = ["histogram_document"]

LEVELS = 256


def histogram_document(image: Image, parameters: SegmentationParameters) -> dict[str, object]:
    """Return the ``slabcell.preview-histogram/1`` object of a picture.

    ``counts`` (256,) are of the whole picture with 8 bits, as the segmentation counts: the region of interest cuts the
    mask, not the histogram.  ``level`` is where the method cuts, in these 256 levels; None where it has no one level.
    ``low`` and ``high`` are the range between the tails, from which dynamic methods take their level.  Times
    ``grey_per_level`` a level is a grey of the picture itself, which the parameter ``threshold`` counts in.
    """
    grey = as_grey(image)
    counts = np.bincount(as_8_bit(grey).ravel(), minlength=LEVELS)
    low, high = dynamic_range(counts, parameters.low_tail_percent, parameters.high_tail_percent)
    found = segment(grey, parameters.model_copy(update={"roi": None, "morphology": []}), image)
    per_level = 1.0 if grey.dtype == np.uint8 else max(float(np.percentile(grey[::4, ::4], 99.9)), 1.0) / 255.0
    return {
        "schema": "slabcell.preview-histogram/1",
        "counts": counts.tolist(),
        "level": _level(found.level, found.contrast, parameters, per_level),
        "light": found.light,
        "low": low,
        "high": high,
        "grey_per_level": round(per_level, 4),
    }


def _level(level: float | None, contrast: float, parameters: SegmentationParameters, per_level: float) -> float | None:
    if parameters.method == "fixed" and parameters.threshold is not None:
        return round(parameters.threshold / per_level + (0.5 if per_level == 1.0 else 0.0), 2)
    return None if level is None or contrast == 0.0 else round(level, 2)
