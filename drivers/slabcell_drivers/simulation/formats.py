"""How does brightness become the numbers of a pixel format?  Noise, bits, and the colour mosaic of a sensor.

Names and alignment are those of the GenICam Pixel Format Naming Convention: unpacked 10 and 12 bits lie at the lower
end of 16.  Colour is blue, green, red, as OpenCV orders it.
"""

from enum import StrEnum

import numpy as np
import numpy.typing as npt

from slabcell_drivers.simulation.scene import Optics
from slabcell_drivers.simulation.surfaces import sensor_noise

__all__ = ["PixelFormat", "Pixels", "digitise", "mosaic"]

Field = npt.NDArray[np.float32]
Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class PixelFormat(StrEnum):
    """What a simulated camera can deliver."""

    MONO8 = "Mono8"
    MONO10 = "Mono10"
    MONO12 = "Mono12"
    MONO16 = "Mono16"
    BGR8 = "BGR8"

    @property
    def bits(self) -> int:
        """Bits of one value."""
        return {"Mono8": 8, "Mono10": 10, "Mono12": 12, "Mono16": 16, "BGR8": 8}[self.value]


def digitise(
    image: Field, optics: Optics, seed: tuple[int, ...], pixel_format: PixelFormat = PixelFormat.MONO8
) -> Pixels:
    """Return what a sensor makes of a brightness in grey levels of 8 bits: noise, then the format's own levels.

    The shape stays: (height, width), or (height, width, 3) for colour.
    """
    noisy = sensor_noise(image, optics.noise_dn, optics.shot_dn, seed)
    top = (1 << pixel_format.bits) - 1
    if top > 255:
        return np.clip(np.rint(noisy * (top / 255.0)), 0, top).astype(np.uint16)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def mosaic(colour: npt.NDArray[np.uint8], pattern: str = "RG") -> npt.NDArray[np.uint8]:
    """Return the raw picture of a sensor with a Bayer mosaic, shape (height, width).

    ``pattern`` names the first two pixels of the first row: RG, GR, GB or BG.
    """
    blue, green, red = 0, 1, 2
    try:
        cells = {
            "RG": ((red, green), (green, blue)),
            "GR": ((green, red), (blue, green)),
            "GB": ((green, blue), (red, green)),
            "BG": ((blue, green), (green, red)),
        }[pattern]
    except KeyError:
        msg = f"Bayer pattern {pattern!r} is not one of RG, GR, GB, BG"
        raise ValueError(msg) from None
    raw = np.empty(colour.shape[:2], np.uint8)
    for row in (0, 1):
        for column in (0, 1):
            raw[row::2, column::2] = colour[row::2, column::2, cells[row][column]]
    return raw
