"""What do the bytes of a picture mean?  Pixel formats of the GenICam naming convention, and how each becomes an array.

Converted once, where a frame enters the house:

- 8-bit grey stays uint8; 10, 12 and 16 bits become uint16 with the sensor's value in the upper bits (a 12-bit value is
  shifted left by 4), so that full scale is 65535 whatever the camera's depth and nobody downstream needs to know it.
- Bayer and RGB pictures become (h, w, 3) in the order blue, green, red, with 8 or 16 bits by the same rule.

Sources: EMVA, GenICam Pixel Format Naming Convention (PFNC) and its values; GigE Vision 1.2 for `...Packed`.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.protocol import Pixels

__all__ = ["PIXEL_FORMATS", "Layout", "PixelFormat", "PixelFormatError", "decode_pixels", "format_of_code"]


class PixelFormatError(Exception):
    """Bytes do not fit the format they claim, or the format is not known."""


class Layout(Enum):
    """How the values lie in memory."""

    BYTES = "one byte a value"
    WORDS = "two bytes a value, little-endian, value in the lower bits"
    PACKED_GEV = "two values in three bytes: upper bits, both lower bits, upper bits"
    PACKED_LSB = "values one after the other, least significant bit first"


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """One format: its PFNC code, layout, significant bits and, for colour, what the channels are.

    ``bayer`` is the colour of the first two pixels of the first row ("RG"); ``channels`` is 3 for RGB and BGR.
    """

    name: str
    code: int
    layout: Layout
    bits: int
    bayer: str = ""
    channels: int = 1

    @property
    def bits_per_pixel(self) -> int:
        """Bits that a pixel takes in a frame."""
        return (self.code >> 16) & 0xFF

    def frame_bytes(self, width: int, height: int) -> int:
        """Bytes of a whole picture without padding."""
        return (width * height * self.bits_per_pixel + 7) // 8


def _table() -> dict[str, PixelFormat]:
    byte, word, gev, lsb = Layout.BYTES, Layout.WORDS, Layout.PACKED_GEV, Layout.PACKED_LSB
    formats = [
        PixelFormat("Mono8", 0x0108_0001, byte, 8),
        PixelFormat("Mono10", 0x0110_0003, word, 10),
        PixelFormat("Mono10Packed", 0x010C_0004, gev, 10),
        PixelFormat("Mono10p", 0x010A_0046, lsb, 10),
        PixelFormat("Mono12", 0x0110_0005, word, 12),
        PixelFormat("Mono12Packed", 0x010C_0006, gev, 12),
        PixelFormat("Mono12p", 0x010C_0047, lsb, 12),
        PixelFormat("Mono16", 0x0110_0007, word, 16),
        PixelFormat("RGB8", 0x0218_0014, byte, 8, channels=3),
        PixelFormat("BGR8", 0x0218_0015, byte, 8, channels=3),
    ]
    for number, pattern in enumerate(("GR", "RG", "GB", "BG")):
        formats += [
            PixelFormat(f"Bayer{pattern}8", 0x0108_0008 + number, byte, 8, bayer=pattern),
            PixelFormat(f"Bayer{pattern}10", 0x0110_000C + number, word, 10, bayer=pattern),
            PixelFormat(f"Bayer{pattern}12", 0x0110_0010 + number, word, 12, bayer=pattern),
            PixelFormat(f"Bayer{pattern}12Packed", 0x010C_002A + number, gev, 12, bayer=pattern),
        ]
    for number, pattern in enumerate(("BG", "GB", "GR", "RG")):
        formats.append(PixelFormat(f"Bayer{pattern}12p", 0x010C_0053 + 2 * number, lsb, 12, bayer=pattern))
    return {entry.name: entry for entry in formats}


PIXEL_FORMATS: Final = _table()
_BY_CODE: Final = {entry.code: entry for entry in PIXEL_FORMATS.values()}

# OpenCV names a Bayer pattern by the second and third pixel of the second row, not by the first of the first.
_BAYER_TO_BGR: Final = {
    "RG": cv2.COLOR_BayerBG2BGR,
    "GR": cv2.COLOR_BayerGB2BGR,
    "GB": cv2.COLOR_BayerGR2BGR,
    "BG": cv2.COLOR_BayerRG2BGR,
}


def format_of_code(code: int) -> PixelFormat:
    """Return the format of a PFNC code.  Raises PixelFormatError."""
    found = _BY_CODE.get(code)
    if found is None:
        raise PixelFormatError(f"pixel format 0x{code:08x} is not known; set one of {', '.join(PIXEL_FORMATS)}")
    return found


def decode_pixels(data: npt.NDArray[np.uint8], width: int, height: int, form: PixelFormat) -> Pixels:
    """Return the picture in ``data``, a flat array of bytes without row padding; always in memory of its own.

    Shape (height, width), or (height, width, 3) in BGR order for colour; uint8 or uint16 as the module says.
    Raises PixelFormatError.
    """
    need = form.frame_bytes(width, height)
    if width < 1 or height < 1 or data.size < need:
        raise PixelFormatError(f"{form.name} at {width}x{height} pixels takes {need} bytes; the frame has {data.size}")
    data = data[:need]
    if form.channels == 3:
        image = data.reshape(height, width, 3)
        return image[:, :, ::-1].copy() if form.name == "RGB8" else image.copy()
    values = _values(data, (height, width), form)
    if not form.bayer:
        return values
    colour = cv2.cvtColor(values, _BAYER_TO_BGR[form.bayer])
    return np.asarray(colour, np.uint8) if values.dtype == np.uint8 else np.asarray(colour, np.uint16)


def _values(data: npt.NDArray[np.uint8], shape: tuple[int, int], form: PixelFormat) -> Pixels:
    """Return one value a pixel, uint16 shifted up to full scale where the format has more than 8 bits."""
    if form.layout is Layout.BYTES:
        return data.reshape(shape).copy()
    count = shape[0] * shape[1]
    shift = 16 - form.bits
    if form.layout is Layout.WORDS:
        return np.left_shift(data.view("<u2").reshape(shape), shift).astype(np.uint16, copy=False)
    wide = np.zeros(_padded(count, form), np.uint16)
    if form.layout is Layout.PACKED_GEV:
        triples = np.zeros(-(-data.size // 3) * 3, np.uint8)
        triples[: data.size] = data
        first, lower, second = triples[0::3], triples[1::3], triples[2::3]
        low = form.bits - 8
        mask = (1 << low) - 1
        wide[0::2] = (first.astype(np.uint16) << low) | (lower & mask)
        wide[1::2] = (second.astype(np.uint16) << low) | ((lower >> 4) & mask)
    elif form.bits == 12:
        triples = np.zeros(-(-data.size // 3) * 3, np.uint8)
        triples[: data.size] = data
        a, b, c = (triples[i::3].astype(np.uint16) for i in range(3))
        wide[0::2] = a | ((b & 0x0F) << 8)
        wide[1::2] = (b >> 4) | (c << 4)
    else:  # 10 bits: four values in five bytes
        fives = np.zeros(-(-data.size // 5) * 5, np.uint8)
        fives[: data.size] = data
        a, b, c, d, e = (fives[i::5].astype(np.uint16) for i in range(5))
        wide[0::4] = a | ((b & 0x03) << 8)
        wide[1::4] = (b >> 2) | ((c & 0x0F) << 6)
        wide[2::4] = (c >> 4) | ((d & 0x3F) << 4)
        wide[3::4] = (d >> 6) | (e << 2)
    return np.left_shift(wide[:count].reshape(shape), shift)


def _padded(count: int, form: PixelFormat) -> int:
    """Return the number of values rounded up to whole groups of bytes."""
    group = 4 if form.layout is Layout.PACKED_LSB and form.bits == 10 else 2
    return -(-count // group) * group
