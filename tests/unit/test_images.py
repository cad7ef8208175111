import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell.errors import ImageError
from slabcell.images import decode_image, read_image

pytestmark = pytest.mark.unit

GREY = np.random.default_rng(1).integers(0, 256, (40, 60), np.uint8)


def encoded(suffix: str, picture: np.ndarray) -> bytes:
    done, raw = cv2.imencode(suffix, picture)
    assert done
    return raw.tobytes()


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
@pytest.mark.parametrize(
    "picture",
    [GREY, GREY.astype(np.uint16) * 257, np.dstack([GREY, GREY // 2, GREY // 3])],
    ids=["grey", "16 bit", "colour"],
)
def test_lossless_pictures_come_back_as_they_were(tmp_path: Path, suffix: str, picture: np.ndarray):
    path = tmp_path / f"picture{suffix}"
    path.write_bytes(encoded(suffix, picture))
    read = read_image(path)
    assert read.dtype == picture.dtype
    assert np.array_equal(read, picture)


def test_a_jpeg_comes_back_with_its_size():
    assert decode_image(encoded(".jpg", GREY), "a.jpg").shape == GREY.shape
    assert decode_image(encoded(".jpg", np.dstack([GREY] * 3)), "a.jpg").shape == (*GREY.shape, 3)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff"])
@pytest.mark.parametrize("share", [0.01, 0.3, 0.9, 0.99])
def test_a_truncated_picture_is_refused_by_name(suffix: str, share: float):
    raw = encoded(suffix, GREY)
    with pytest.raises(ImageError, match="cut"):
        decode_image(raw[: max(1, int(len(raw) * share))], f"cut{suffix}")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tiff"])
def test_every_prefix_of_a_picture_is_refused_or_whole(suffix: str):
    raw = encoded(suffix, GREY)
    for length in range(0, len(raw), 7):
        try:
            picture = decode_image(raw[:length], "prefix")
        except ImageError:
            continue
        # A TIFF may carry its directory before its end: what is accepted must be complete.
        assert picture.shape == GREY.shape
        if suffix != ".jpg":
            assert np.array_equal(picture, GREY)


def test_a_png_with_a_flipped_byte_is_refused():
    raw = bytearray(encoded(".png", GREY))
    raw[len(raw) // 2] ^= 0x10
    with pytest.raises(ImageError, match="damaged"):
        decode_image(bytes(raw), "flipped.png")


@pytest.mark.parametrize(
    "raw", [b"", b"x", b"hello, this is text", b"\x89PNG", b"GIF89a" + bytes(40), b"\xff\xd8", b"II*\0", bytes(100)]
)
def test_what_is_no_picture_is_refused(raw: bytes):
    with pytest.raises(ImageError, match="thing"):
        decode_image(raw, "thing")


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(ImageError, match=r"nowhere\.png: cannot be read: No such file"):
        read_image(tmp_path / "nowhere.png")


def test_a_directory_is_no_picture(tmp_path: Path):
    with pytest.raises(ImageError, match="cannot be read"):
        read_image(tmp_path)


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def test_a_picture_that_claims_to_be_enormous_is_refused_before_it_is_decoded():
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 100_000, 100_000, 8, 0, 0, 0, 0))
    bomb = b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    with pytest.raises(ImageError, match="100000x100000"):
        decode_image(bomb, "bomb.png")


def test_a_tiff_that_claims_to_be_enormous_is_refused():
    entries = [(256, 4, 1, 200_000), (257, 4, 1, 200_000)]
    body = io.BytesIO()
    body.write(b"II*\0" + struct.pack("<IH", 8, len(entries)))
    for entry in entries:
        body.write(struct.pack("<HHII", *entry))
    body.write(struct.pack("<I", 0) + bytes(100))
    with pytest.raises(ImageError, match="200000x200000"):
        decode_image(body.getvalue(), "bomb.tif")


def test_random_bytes_after_a_known_beginning_give_a_typed_error_or_a_picture():
    random = np.random.default_rng(5)
    for beginning in (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"II*\0", b"MM\0*"):
        for _ in range(200):
            raw = beginning + random.bytes(int(random.integers(0, 200)))
            with pytest.raises(ImageError):
                decode_image(raw, "fuzz")


def test_a_picture_with_transparency_loses_it():
    raw = encoded(".png", np.dstack([GREY] * 4))
    assert decode_image(raw, "a.png").shape == (*GREY.shape, 3)


def test_32_bit_floats_are_refused():
    with pytest.raises(ImageError, match="float32"):
        decode_image(encoded(".tiff", GREY.astype(np.float32)), "float.tiff")
