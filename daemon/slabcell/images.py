"""How is a picture file read?  PNG, JPEG or TIFF, 8 or 16 bit, grey or colour; bounded, and never half of a file.

The header is read first, by hand, so that a picture that claims to be enormous is refused before anything is
decoded.  OpenCV returns the upper part of a truncated JPEG or PNG without an error, so completeness is checked here:
every PNG chunk up to IEND with its CRC, and the JPEG's end-of-image marker.

Sources: W3C, PNG specification (third edition), §5; ITU-T T.81 (JPEG) annex B; Adobe TIFF 6.0, sections 2 and 8.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError

__all__ = ["Image", "decode_image", "encode_image", "image_size", "read_image"]

Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""A picture: shape (h, w) grey or (h, w, 3) in the order blue, green, red; uint8 or uint16."""

MAX_FILE_BYTES: Final = 512 << 20
MAX_PIXELS: Final = 100_000_000

_PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_STRIP_OFFSETS, _TIFF_STRIP_BYTES = 273, 279
_TIFF_TILE_OFFSETS, _TIFF_TILE_BYTES = 324, 325
_TIFF_SIZES: Final = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
_JPEG_WITHOUT_LENGTH: Final = frozenset({0x01, *range(0xD0, 0xD9)})
_JPEG_FRAME: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


def read_image(path: Path) -> Image:
    """Return the picture of a file.  Raises ImageError that names the file and the cause."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise ImageError(msg) from error
    return decode_image(raw, str(path))


def encode_image(picture: Image, source: str, kind: str = ".png") -> bytes:
    """Return a picture as a file of a kind, named by its ending; ``source`` stands in messages.  Raises ImageError."""
    done, encoded = cv2.imencode(kind, picture)
    if not done:
        msg = f"{source}: the picture cannot be encoded as {kind}"
        raise ImageError(msg)
    return encoded.tobytes()


def decode_image(raw: bytes, source: str) -> Image:
    """Return the picture in a file's bytes; ``source`` stands in messages.  Raises ImageError."""
    if len(raw) > MAX_FILE_BYTES:
        msg = f"{source}: is larger than {MAX_FILE_BYTES >> 20} MiB; the limit is for every picture file"
        raise ImageError(msg)
    if not raw:
        msg = f"{source}: is empty; take or copy the picture again"
        raise ImageError(msg)
    width, height = image_size(raw, source)
    return _decode(raw, source, width, height)


def image_size(raw: bytes, source: str) -> tuple[int, int]:
    """Return width and height of the picture in a complete file, which is not decoded.  Raises ImageError."""
    try:
        width, height = _size(raw)
    except (struct.error, IndexError) as error:
        msg = f"{source}: ends within its header; it is truncated, copy it again"
        raise ImageError(msg) from error
    except _UnusableError as error:
        msg = f"{source}: {error}"
        raise ImageError(msg) from error
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        msg = f"{source}: claims {width}x{height} pixels; a picture has between 1 and {MAX_PIXELS} of them"
        raise ImageError(msg)
    return width, height


class _UnusableError(Exception):
    """Why a file cannot be used, without its name."""


def _decode(raw: bytes, source: str, width: int, height: int) -> Image:
    flags = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        decoded = cv2.imdecode(np.frombuffer(raw, np.uint8), flags)
    except (cv2.error, MemoryError) as error:
        msg = f"{source}: cannot be decoded ({type(error).__name__}); save it again as PNG"
        raise ImageError(msg) from error
    # imdecode returns None for what it cannot decode, which its type stub does not say.
    found: npt.NDArray[np.generic] | None = decoded
    if found is None:
        msg = f"{source}: cannot be decoded; it is damaged, or of a kind that is not supported: save it again as PNG"
        raise ImageError(msg)
    if found.shape[:2] != (height, width):
        msg = f"{source}: its header says {width}x{height}, its data {found.shape[1]}x{found.shape[0]}; it is damaged"
        raise ImageError(msg)
    if found.ndim == 3 and found.shape[2] != 3:
        msg = f"{source}: has {found.shape[2]} channels; a picture is grey (1) or colour (3)"
        raise ImageError(msg)
    if found.dtype == np.uint8:
        return found.astype(np.uint8, copy=False)
    if found.dtype == np.uint16:
        return found.astype(np.uint16, copy=False)
    msg = f"{source}: holds values of type {found.dtype}; save it with 8 or 16 bits"
    raise ImageError(msg)


def _size(raw: bytes) -> tuple[int, int]:
    """Return width and height as the header gives them, once the file is known to be complete."""
    if raw.startswith(_PNG_SIGNATURE):
        return _png_size(raw)
    if raw.startswith(b"\xff\xd8"):
        return _jpeg_size(raw)
    if raw[:4] in (b"II*\0", b"MM\0*"):
        return _tiff_size(raw)
    if _PNG_SIGNATURE.startswith(raw[:8]):
        msg = f"ends after {len(raw)} bytes; it is truncated, copy it again"
        raise _UnusableError(msg)
    msg = "is no PNG, JPEG or TIFF picture; save it as one of them"
    raise _UnusableError(msg)


def _png_size(raw: bytes) -> tuple[int, int]:
    position = len(_PNG_SIGNATURE)
    size: tuple[int, int] | None = None
    while True:
        if position + 12 > len(raw):
            msg = f"is truncated: a PNG ends with the chunk IEND, this one ends at byte {len(raw)}; copy it again"
            raise _UnusableError(msg)
        length, kind = struct.unpack_from(">I4s", raw, position)
        end = position + 12 + length
        if end > len(raw):
            msg = f"is truncated: the PNG chunk at byte {position} needs {end - len(raw)} bytes more; copy it again"
            raise _UnusableError(msg)
        (crc,) = struct.unpack_from(">I", raw, end - 4)
        if zlib.crc32(memoryview(raw)[position + 4 : end - 4]) != crc:
            msg = f"is damaged: the checksum of the PNG chunk at byte {position} is wrong; copy it again"
            raise _UnusableError(msg)
        if size is None:
            if kind != b"IHDR" or length != 13:
                msg = "is damaged: a PNG begins with the chunk IHDR"
                raise _UnusableError(msg)
            width, height = struct.unpack_from(">II", raw, position + 8)
            if width * height > MAX_PIXELS:  # before megabytes of chunks are looked at
                return width, height
            size = (width, height)
        if kind == b"IEND":
            return size
        position = end


def _jpeg_size(raw: bytes) -> tuple[int, int]:
    if raw.rstrip(b"\0").rfind(b"\xff\xd9", -4096) < 0:
        msg = f"is truncated: a JPEG ends with FF D9, this one ends at byte {len(raw)} without; copy it again"
        raise _UnusableError(msg)
    for marker, position in _jpeg_segments(raw):
        if marker in _JPEG_FRAME:
            height, width = struct.unpack_from(">HH", raw, position + 5)
            return width, height
    msg = "is damaged: this JPEG has no frame header"
    raise _UnusableError(msg)


def _jpeg_segments(raw: bytes) -> Iterator[tuple[int, int]]:
    """Yield marker and position of every segment up to the first scan."""
    position = 2
    while True:
        while raw[position] == 0xFF and raw[position + 1] == 0xFF:
            position += 1
        if raw[position] != 0xFF:
            msg = f"is damaged: byte {position} of this JPEG begins no segment"
            raise _UnusableError(msg)
        marker = raw[position + 1]
        if marker in (0xD9, 0xDA):
            return
        yield marker, position
        position += 2
        if marker not in _JPEG_WITHOUT_LENGTH:
            (length,) = struct.unpack_from(">H", raw, position)
            position += max(int(length), 2)


def _tiff_size(raw: bytes) -> tuple[int, int]:
    order = "<" if raw[:2] == b"II" else ">"
    (directory,) = struct.unpack_from(order + "I", raw, 4)
    (entries,) = struct.unpack_from(order + "H", raw, directory)
    values: dict[int, tuple[int, ...]] = {}
    wanted = (_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_STRIP_OFFSETS, _TIFF_STRIP_BYTES, _TIFF_TILE_OFFSETS, _TIFF_TILE_BYTES)
    for index in range(entries):
        entry = directory + 2 + 12 * index
        tag, kind, count = struct.unpack_from(order + "HHI", raw, entry)
        if tag in wanted and kind in (3, 4):
            if count > len(raw) // _TIFF_SIZES[kind]:
                msg = f"is truncated: its TIFF tag {tag} claims {count} values; copy it again"
                raise _UnusableError(msg)
            place = entry + 8
            if count * _TIFF_SIZES[kind] > 4:
                (place,) = struct.unpack_from(order + "I", raw, place)
            values[tag] = struct.unpack_from(f"{order}{count}{'H' if kind == 3 else 'I'}", raw, place)
    for first, lengths in ((_TIFF_STRIP_OFFSETS, _TIFF_STRIP_BYTES), (_TIFF_TILE_OFFSETS, _TIFF_TILE_BYTES)):
        for offset, length in zip(values.get(first, ()), values.get(lengths, ()), strict=False):
            if offset + length > len(raw):
                msg = (
                    f"is truncated: its TIFF data ends {offset + length - len(raw)} bytes after the file; copy it again"
                )
                raise _UnusableError(msg)
    if not values.get(_TIFF_WIDTH) or not values.get(_TIFF_HEIGHT):
        msg = "is damaged: this TIFF names no width and height"
        raise _UnusableError(msg)
    return values[_TIFF_WIDTH][0], values[_TIFF_HEIGHT][0]
