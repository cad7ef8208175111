"""Which picture is meant?  The newest one, that of a cycle, or one that somebody has uploaded.

=====================  ===================================================================
``latest``             the newest picture of the camera
``cycle:NUMBER``       the picture of an ended cycle, from its bundle
``upload:ID``          what was uploaded a while ago
=====================  ===================================================================
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

from slabcell.cell.bundle_file import BundleError
from slabcell.errors import SlabcellError
from slabcell.images import image_size
from slabcell.service.bench.wire import Json
from slabcell.service.bench.work import picture_blob
from slabcell.service.bundles import BundleShelf
from slabcell.service.expiring import Expiring
from slabcell.service.frames import FrameStore
from slabcell.service.history import History

__all__ = ["MAX_UPLOAD_BYTES", "NoSuchPictureError", "Picture", "Pictures"]

MAX_UPLOAD_BYTES: Final = 32 << 20
MAX_UPLOADS: Final = 6
KEPT_S: Final = 900.0


class NoSuchPictureError(SlabcellError):
    """There is no such picture, or not any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture, as the bench takes it: ``arguments`` say what ``blob`` is."""

    name: str
    arguments: Json
    blob: bytes | memoryview


class Pictures:
    """The pictures of one cell that people may work on."""

    def __init__(self, frames: FrameStore, bundles: BundleShelf, history: History) -> None:
        self._frames = frames
        self._bundles = bundles
        self._history = history
        self.uploads: Expiring[bytes] = Expiring(number=MAX_UPLOADS, total_bytes=4 * MAX_UPLOAD_BYTES, kept_s=KEPT_S)

    async def upload(self, raw: bytes) -> tuple[str, int, int]:
        """Keep a picture file for a while; return how it is called, width and height.  Raises ImageError."""
        width, height = await asyncio.to_thread(image_size, raw, "the picture")
        name = (await asyncio.to_thread(sha256, raw)).hexdigest()[:16]
        self.uploads.add(name, raw, len(raw))
        return f"upload:{name}", width, height

    async def choose(self, name: str) -> Picture:
        """Return the picture of a name.  Raises NoSuchPictureError."""
        kind, _, which = name.partition(":")
        if name == "latest":
            shown = self._frames.last
            if shown is None:
                msg = "no picture was taken since the daemon started"
                raise NoSuchPictureError(msg)
            return Picture(self._frames.id_of(shown), *picture_blob(shown.pixels))
        if kind == "upload":
            raw = self.uploads.get(which)
            if raw is None:
                msg = f"{name:.60}: was not uploaded, or is not kept any more: uploads are for {KEPT_S / 60:.0f} min"
                raise NoSuchPictureError(msg)
            return Picture(name, {}, raw)
        if kind == "cycle" and which.isascii() and which.isdecimal() and len(which) < 18:
            return Picture(name, {}, await self._of_cycle(int(which)))
        msg = f"picture {name!r:.60}: say latest, cycle:NUMBER or upload:ID"
        raise NoSuchPictureError(msg)

    async def _of_cycle(self, number: int) -> bytes:
        row = await self._history.read(lambda file: file.cycle(number))
        if row is None:
            msg = f"there is no cycle {number}, or not any more"
            raise NoSuchPictureError(msg)
        try:
            return await asyncio.to_thread(self._bundles.member, row.bundle, "frame.png")
        except BundleError as error:
            raise NoSuchPictureError(str(error)) from error
