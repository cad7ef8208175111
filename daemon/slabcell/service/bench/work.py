"""What does a task get, and what does it give?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slabcell.images import Image, decode_image
from slabcell.service.bench.wire import Json, Message

__all__ = ["Task", "Work", "picture_blob", "pixels_of"]


@dataclass(frozen=True, slots=True)
class Work:
    """One task: its arguments, its blobs, and whom to tell how far it is."""

    arguments: Json
    blobs: tuple[bytes, ...]
    progress: Callable[[Json], None]

    def picture(self) -> Image:
        """Return the picture that is the first blob: pixels as they are where ``shape`` is given, else a file.

        Raises ImageError.
        """
        return pixels_of(self.arguments, self.blobs[0])


Task = Callable[[Work], Message]


def pixels_of(arguments: Json, blob: bytes | memoryview) -> Image:
    """Return the picture of a blob.  Raises ImageError."""
    shape = arguments.get("shape")
    if shape is None:
        return decode_image(bytes(blob), "the picture")
    if arguments["dtype"] == "uint16":
        return np.frombuffer(blob, np.uint16).reshape(shape)
    return np.frombuffer(blob, np.uint8).reshape(shape)


def picture_blob(pixels: Image) -> tuple[Json, memoryview]:
    """Return the arguments and the blob that `pixels_of` makes the pixels of again."""
    whole = np.ascontiguousarray(pixels)
    return {"shape": list(whole.shape), "dtype": str(whole.dtype)}, whole.reshape(-1).view(np.uint8).data
