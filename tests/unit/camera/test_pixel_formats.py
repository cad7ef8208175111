"""Do the bytes of every pixel format become the right values?  On bytes written by hand, then on round trips."""

import numpy as np
import pytest

from slabcell_drivers.camera.pixel_formats import (
    PIXEL_FORMATS,
    PixelFormatError,
    decode_pixels,
    format_of_code,
)
from slabcell_drivers.simulation.gige.sensor import encode_pixels

pytestmark = pytest.mark.unit


def decode(name: str, data: bytes, width: int, height: int = 1) -> np.ndarray:
    return decode_pixels(np.frombuffer(data, np.uint8), width, height, PIXEL_FORMATS[name])


@pytest.mark.parametrize(
    ("name", "data", "values"),
    [
        ("Mono8", "0102ff", [1, 2, 255]),
        ("Mono10", "ff03 0100", [0x3FF << 6, 1 << 6]),
        ("Mono12", "ff0f 0100", [0xFFF << 4, 1 << 4]),
        ("Mono16", "3412 ffff", [0x1234, 0xFFFF]),
        # PFNC "p": pixel 0 in the lowest bits
        ("Mono12p", "bc da ef", [0xABC << 4, 0xEFD << 4]),
        ("Mono10p", "01 08 30 00 01", [1 << 6, 2 << 6, 3 << 6, 4 << 6]),
        # GigE Vision "Packed": upper bits, both lower bits, upper bits
        ("Mono12Packed", "ab dc ef", [0xABC << 4, 0xEFD << 4]),
        ("Mono10Packed", "ff 13 80", [0x3FF << 6, 0x201 << 6]),
    ],
)
def test_grey_bytes_become_values_at_full_scale(name: str, data: str, values: list[int]):
    assert decode(name, bytes.fromhex(data), len(values)).tolist() == [values]


def test_rgb_becomes_blue_green_red():
    assert decode("RGB8", bytes([1, 2, 3, 4, 5, 6]), 2).tolist() == [[[3, 2, 1], [6, 5, 4]]]


@pytest.mark.parametrize("pattern", ["RG", "GR", "GB", "BG"])
@pytest.mark.parametrize("kind", ["8", "12", "12p", "12Packed"])
def test_a_colour_seen_through_any_bayer_pattern_stays_that_colour(pattern: str, kind: str):
    form = PIXEL_FORMATS[f"Bayer{pattern}{kind}"]
    blue, green, red = 30, 90, 200
    picture = np.broadcast_to(np.array([blue, green, red], np.uint8), (16, 16, 3)).copy()
    seen = decode_pixels(encode_pixels(picture, form), 16, 16, form)
    scale = 1 if kind == "8" else 257
    assert seen.dtype == (np.uint8 if kind == "8" else np.uint16)
    assert np.abs(seen[2:-2, 2:-2].astype(int) // scale - [blue, green, red]).max() <= 1


@pytest.mark.parametrize("name", [name for name, form in PIXEL_FORMATS.items() if not form.bayer])
@pytest.mark.parametrize("size", [(64, 48), (5, 3), (1, 1)])
def test_what_the_camera_codes_the_host_reads(name: str, size: tuple[int, int]):
    form = PIXEL_FORMATS[name]
    width, height = size
    picture = np.random.default_rng(3).integers(0, 65_536, (height, width), np.uint16)
    data = encode_pixels(picture, form)
    assert data.size == form.frame_bytes(width, height)
    seen = decode_pixels(data, width, height, form)
    if form.channels == 3:
        assert np.array_equal(seen, np.repeat((picture >> 8).astype(np.uint8)[:, :, None], 3, axis=2))
    elif form.bits == 8:
        assert np.array_equal(seen, picture >> 8)
    else:
        shift = 16 - form.bits
        assert np.array_equal(seen, picture >> shift << shift)


def test_pixels_own_their_memory():
    data = np.zeros(16, np.uint8)
    seen = decode_pixels(data, 4, 4, PIXEL_FORMATS["Mono8"])
    data[:] = 9
    assert seen.max() == 0


def test_too_few_bytes_and_unknown_codes_are_named():
    with pytest.raises(PixelFormatError, match=r"Mono12 at 4x4 pixels takes 32 bytes; the frame has 31"):
        decode_pixels(np.zeros(31, np.uint8), 4, 4, PIXEL_FORMATS["Mono12"])
    with pytest.raises(PixelFormatError, match="0x01080099"):
        format_of_code(0x0108_0099)
    assert format_of_code(0x0108_0001).name == "Mono8"
