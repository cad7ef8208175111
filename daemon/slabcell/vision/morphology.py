"""How is a mask cleaned?  Opening, closing, eroding, dilating and filling, in the order of the recipe."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.recipe import MorphologyStep

__all__ = ["apply_morphology", "net_erosion_px"]

Mask = npt.NDArray[np.uint8]

# From this size on distances to the nearest pixel of the other kind are taken, whose cost does not grow with the size.
LARGE_PX = 15


def apply_morphology(mask: Mask, steps: Sequence[MorphologyStep]) -> Mask:
    """Return the mask after every step.  What lies outside of the picture is neither slab nor table."""
    for step in steps:
        match step.operation:
            case "fill":
                mask = _filled(mask)
            case "erode":
                mask = _eroded(mask, step.size_px)
            case "dilate":
                mask = _dilated(mask, step.size_px)
            case "open":
                mask = _dilated(_eroded(mask, step.size_px), step.size_px)
            case "close":
                mask = _eroded(_dilated(mask, step.size_px), step.size_px)
    return mask


def net_erosion_px(steps: Sequence[MorphologyStep]) -> float:
    """Return by how much the outlines of what remains lie inside of where they were, in pixels; negative: outside."""
    signs = {"erode": 0.5, "dilate": -0.5}
    return sum(signs.get(step.operation, 0.0) * (step.size_px - 1) for step in steps)


def _eroded(mask: Mask, size_px: int) -> Mask:
    """Return where a disc of this diameter lies wholly in the mask."""
    if size_px < LARGE_PX:
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size_px, size_px))
        return np.asarray(cv2.erode(mask, disc), np.uint8)
    inner = cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return (np.asarray(inner) > 0.5 * size_px).astype(np.uint8) * np.uint8(255)


def _dilated(mask: Mask, size_px: int) -> Mask:
    return np.asarray(cv2.bitwise_not(_eroded(np.asarray(cv2.bitwise_not(mask), np.uint8), size_px)), np.uint8)


def _filled(mask: Mask) -> Mask:
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    filled = np.zeros_like(mask)
    cv2.drawContours(filled, outlines, -1, 255, cv2.FILLED)
    return filled
