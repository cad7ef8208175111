"""Which picture was the last one, and what was found in it?  For people to look at; one picture is kept in memory.

Encoding happens in a thread of low priority, once for each picture and format, whatever the number of clients.
"""

from __future__ import annotations

import asyncio
import os
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum

import cv2

from slabcell.cell.executor import end_executor
from slabcell.errors import ImageError
from slabcell.vision.result import LocateResult
from slabcell_drivers.camera.protocol import ImageFrame, Pixels

__all__ = ["FrameStore", "PictureFormat", "Shown", "age_s"]

PNG_LEVEL = 1
JPEG_QUALITY = 85
NICE = 15
MAX_WAITING = 4


class PictureFormat(StrEnum):
    """How a picture is sent."""

    PNG = "png"
    JPEG = "jpg"

    @property
    def media_type(self) -> str:
        """Its name on the wire."""
        return "image/png" if self is PictureFormat.PNG else "image/jpeg"


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A picture that people may look at; ``serial`` counts pictures since the daemon started."""

    serial: int
    pixels: Pixels
    pixel_format: str
    taken_s: float
    source: str
    result: LocateResult | None = None


class FrameStore:
    """The last picture of one cell."""

    def __init__(self, epoch: str) -> None:
        self.last: Shown | None = None
        self._epoch = epoch
        self._serial = 0
        self._encoder = ThreadPoolExecutor(1, thread_name_prefix="slabcell-encode", initializer=_be_nice)
        self._encoded: dict[PictureFormat, tuple[int, asyncio.Task[bytes]]] = {}

    def id_of(self, shown: Shown) -> str:
        """Return the id of a picture as clients know it."""
        return f"{self._epoch}-{shown.serial}"

    def show(self, frame: ImageFrame, source: str = "camera") -> None:
        """Take the cell's newest picture."""
        self._serial += 1
        self.last = Shown(self._serial, frame.pixels, frame.pixel_format, frame.received_s, source)

    def located(self, result: LocateResult) -> None:
        """Take what was found in the newest picture."""
        if self.last is not None:
            last = self.last
            self.last = Shown(last.serial, last.pixels, last.pixel_format, last.taken_s, last.source, result)

    async def encoded(self, shown: Shown, kind: PictureFormat) -> bytes:
        """Return a picture as a file.  Raises ImageError."""
        known = self._encoded.get(kind)
        if known is None or known[0] != shown.serial:
            task = asyncio.create_task(self.encode(shown.pixels, kind), name="slabcell-encode")
            known = self._encoded[kind] = (shown.serial, task)
        return await asyncio.shield(known[1])

    async def encode(self, pixels: Pixels, kind: PictureFormat) -> bytes:
        """Return any picture as a file, encoded beside the cell.  Raises ImageError."""
        return await asyncio.get_running_loop().run_in_executor(self._encoder, _encode, pixels, kind)

    async def close(self) -> None:
        """End the thread; may be called twice."""
        await asyncio.gather(*(task for _, task in self._encoded.values()), return_exceptions=True)
        await end_executor(self._encoder)


def _be_nice() -> None:
    """Give this thread a low priority: on Linux it is each thread's own."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)


def _encode(pixels: Pixels, kind: PictureFormat) -> bytes:
    if kind is PictureFormat.JPEG:
        shallow = pixels if pixels.dtype == "uint8" else (pixels >> 8).astype("uint8")
        done, encoded = cv2.imencode(".jpg", shallow, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    else:
        done, encoded = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not done:
        msg = f"a picture of {pixels.shape[1]}x{pixels.shape[0]} pixels could not be encoded as {kind.value}"
        raise ImageError(msg)
    return encoded.tobytes()


def age_s(shown: Shown) -> float:
    """Return how old a picture is, in seconds."""
    return time.monotonic() - shown.taken_s
