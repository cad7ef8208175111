"""How is a mask cleaned?  Opening, closing, eroding, dilating and filling, in the order of the recipe."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import MorphologyStep

__all__ = ["apply_morphology"]

Mask = npt.NDArray[np.uint8]

OPERATIONS = {
    "open": cv2.MORPH_OPEN,
    "close": cv2.MORPH_CLOSE,
    "erode": cv2.MORPH_ERODE,
    "dilate": cv2.MORPH_DILATE,
}


def apply_morphology(mask: Mask, steps: Sequence[MorphologyStep]) -> Mask:
    """Return the mask after every step."""
    for step in steps:
        if step.operation == "fill":
            mask = _filled(mask)
        else:
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (step.size_px, step.size_px))
            mask = cv2.morphologyEx(mask, OPERATIONS[step.operation], disc).astype(np.uint8, copy=False)
    return mask


def _filled(mask: Mask) -> Mask:
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    filled = np.zeros_like(mask)
    cv2.drawContours(filled, outlines, -1, 255, cv2.FILLED)
    return filled
