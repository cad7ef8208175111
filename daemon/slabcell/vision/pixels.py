"""What may a picture be, and how does the vision look at it?  Checks an array, and makes it grey."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError

__all__ = ["Grey", "as_8_bit", "as_grey"]

# What a pixel may be; 16 bits in the order of this machine.
DEPTHS = tuple(np.dtype(depth).str for depth in (np.uint8, np.uint16))

Grey = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""A grey picture, shape (h, w), contiguous."""


def as_grey(image: npt.NDArray[Any]) -> Grey:
    """Return the picture in grey, same depth.  Raises ImageError on a shape or type that no picture has."""
    if image.dtype.str not in DEPTHS:
        msg = f"a picture holds uint8 or uint16, not {image.dtype}"
        raise ImageError(msg)
    if image.size == 0 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3)):
        msg = f"a picture has the shape (h, w) or (h, w, 3), not {image.shape}"
        raise ImageError(msg)
    if image.ndim == 3:
        image = image[:, :, 0] if image.shape[2] == 1 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    grey: Grey = np.ascontiguousarray(image)
    return grey


def as_8_bit(grey: Grey) -> npt.NDArray[np.uint8]:
    """Return the picture with 8 bits; 16 bits are scaled so that nearly the brightest pixel becomes 255."""
    if grey.dtype == np.uint8:
        return grey.astype(np.uint8, copy=False)
    brightest = float(np.percentile(grey[::4, ::4], 99.9))
    scaled = cv2.convertScaleAbs(grey, alpha=255.0 / max(brightest, 1.0))
    return np.asarray(scaled, np.uint8)
