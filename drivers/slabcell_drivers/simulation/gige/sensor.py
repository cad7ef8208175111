"""What does the sensor of the camera in software deliver?  A rendered picture, exposed, cropped and coded as set.

A picture is what a camera at nominal exposure (5 ms) and no gain sees: (h, w) uint8 or uint16 (full scale), or
(h, w, 3) uint8 in BGR order.
"""

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.pixel_formats import Layout, PixelFormat
from slabcell_drivers.camera.protocol import Pixels
from slabcell_drivers.simulation.gige.faults import Faults
from slabcell_drivers.simulation.gige.registers import StreamSettings

__all__ = ["NOMINAL_EXPOSURE_US", "Render", "Sensor", "encode_pixels"]

NOMINAL_EXPOSURE_US: Final = 5000.0
Render = Callable[[int], Pixels]
"""Returns what the camera sees now; it is given the number of the frame and runs on the camera's stream thread."""

_CHANNEL_OF: Final = {"B": 0, "G": 1, "R": 2}
_MOSAIC: Final = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}


class Sensor:
    """Takes pictures of whatever ``render`` shows."""

    def __init__(self, render: Render, faults: Faults) -> None:
        self._render = render
        self._faults = faults
        self._last: Pixels | None = None

    def expose(self, number: int, settings: StreamSettings) -> npt.NDArray[np.uint8]:
        """Return the bytes of frame ``number``, flat."""
        if self._faults.is_on("stuck") and self._last is not None:
            picture = self._last
        else:
            picture = self._last = self._render(number)
        x, y = settings.offset_x, settings.offset_y
        view = picture[y : y + settings.height, x : x + settings.width]
        if view.shape[:2] != (settings.height, settings.width):
            view = _fit(view, settings.width, settings.height)
        factor = settings.exposure_us / NOMINAL_EXPOSURE_US * 10 ** (settings.gain_db / 20)
        if self._faults.is_on("dark"):
            factor /= 24
        if self._faults.is_on("blur"):
            view = _alike(cv2.GaussianBlur(view, (0, 0), 6.0), view)
        if abs(factor - 1) > 1e-6:
            view = _alike(np.clip(view.astype(np.float32) * factor, 0, np.iinfo(view.dtype).max), view)
        return encode_pixels(view, settings.pixel_format)


def _alike(values: npt.ArrayLike, picture: Pixels) -> Pixels:
    """Return values as pixels of the same depth."""
    return np.asarray(values, np.uint16) if picture.dtype == np.uint16 else np.asarray(values, np.uint8)


def _fit(view: Pixels, width: int, height: int) -> Pixels:
    """Return the picture with black where the sensor is larger than the rendered scene."""
    full = np.zeros((height, width, *view.shape[2:]), view.dtype)
    full[: view.shape[0], : view.shape[1]] = view
    return _alike(full, view)


def encode_pixels(picture: Pixels, form: PixelFormat) -> npt.NDArray[np.uint8]:
    """Return the bytes of a picture in a pixel format, flat."""
    if form.channels == 3:
        colour = _eight(picture if picture.ndim == 3 else _alike(np.repeat(picture[:, :, None], 3, axis=2), picture))
        return np.ascontiguousarray(colour[:, :, ::-1] if form.name == "RGB8" else colour).reshape(-1)
    grey = _mosaic(picture, form.bayer) if form.bayer else _grey(picture)
    if form.layout is Layout.BYTES:
        return np.ascontiguousarray(_eight(grey)).reshape(-1)
    wide = grey.astype(np.uint16) * 257 if grey.dtype == np.uint8 else grey.astype(np.uint16)
    values = (wide >> (16 - form.bits)).astype(np.uint16).reshape(-1)
    if form.layout is Layout.WORDS:
        return values.astype("<u2").view(np.uint8)
    return _pack(values, form)


def _eight(picture: Pixels) -> npt.NDArray[np.uint8]:
    return picture.astype(np.uint8, copy=False) if picture.dtype == np.uint8 else (picture >> 8).astype(np.uint8)


def _grey(picture: Pixels) -> Pixels:
    return picture if picture.ndim == 2 else _alike(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), picture)


def _mosaic(picture: Pixels, pattern: str) -> Pixels:
    """Return what a sensor with a Bayer filter sees: one colour a pixel."""
    if picture.ndim == 2:
        return picture
    out = np.zeros(picture.shape[:2], picture.dtype)
    for place, colour in enumerate(_MOSAIC[pattern]):
        row, column = divmod(place, 2)
        out[row::2, column::2] = picture[row::2, column::2, _CHANNEL_OF[colour]]
    return _alike(out, picture)


def _pack(values: npt.NDArray[np.uint16], form: PixelFormat) -> npt.NDArray[np.uint8]:
    """Return 10- or 12-bit values packed; the last group is filled up with zeros and cut to whole bytes."""
    group = 4 if form.layout is Layout.PACKED_LSB and form.bits == 10 else 2
    padded = np.zeros(-(-values.size // group) * group, np.uint16)
    padded[: values.size] = values
    v = [padded[i::group] for i in range(group)]
    if form.layout is Layout.PACKED_GEV:
        low = form.bits - 8
        mask = (1 << low) - 1
        columns = [v[0] >> low, (v[0] & mask) | ((v[1] & mask) << 4), v[1] >> low]
    elif form.bits == 12:
        columns = [v[0], (v[0] >> 8) | (v[1] << 4), v[1] >> 4]
    else:
        columns = [
            v[0], (v[0] >> 8) | (v[1] << 2), (v[1] >> 6) | (v[2] << 4), (v[2] >> 4) | (v[3] << 6), v[3] >> 2,
        ]  # fmt: skip
    packed = np.stack([(column & 0xFF).astype(np.uint8) for column in columns], axis=1).reshape(-1)
    return packed[: (values.size * form.bits_per_pixel + 7) // 8]
