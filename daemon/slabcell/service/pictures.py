"""Which picture is meant?  The newest one, that of a cycle, one that is kept, or one that somebody has uploaded.

=====================  ===================================================================
``latest``             the newest picture of the camera
``cycle:NUMBER``       the picture of an ended cycle, from its bundle
``set:SET/FILE``       a picture of a set that is kept to tune on
``graded:NAME/FILE``   the picture of a bundle out of the graded set of recipe NAME
``upload:ID``          what was uploaded a while ago
=====================  ===================================================================
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

from slabcell.cell.bundle_file import BundleError
from slabcell.images import image_size
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.bench.wire import Json
from slabcell.service.bench.work import picture_blob
from slabcell.service.bundles import BundleShelf
from slabcell.service.expiring import Expiring
from slabcell.service.frames import FrameStore
from slabcell.service.history import History
from slabcell.service.picture_sets import NoSuchPictureError, PictureSets

__all__ = ["MAX_UPLOAD_BYTES", "NoSuchPictureError", "Picture", "Pictures"]

MAX_UPLOAD_BYTES: Final = 32 << 20
MAX_UPLOADS: Final = 6
KEPT_S: Final = 900.0


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One picture, as the bench takes it: ``arguments`` say what ``blob`` is."""

    name: str
    arguments: Json
    blob: bytes | memoryview


class Pictures:
    """The pictures of one cell that people may work on."""

    def __init__(
        self, frames: FrameStore, bundles: BundleShelf, history: History, recipes: RecipeShelf, sets: PictureSets
    ) -> None:
        self.sets = sets
        self._recipes = recipes
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
        folder, slash, file = which.partition("/")
        if kind == "set" and slash:
            return Picture(name, {}, await asyncio.to_thread(lambda: self.sets.path(folder, file).read_bytes()))
        if kind == "graded" and slash:
            return Picture(name, {}, await asyncio.to_thread(self._graded, folder, file))
        msg = f"picture {name!r:.60}: say latest, cycle:NUMBER, set:SET/FILE, graded:RECIPE/FILE or upload:ID"
        raise NoSuchPictureError(msg)

    def _graded(self, recipe: str, bundle: str) -> bytes:
        for folder in self._recipes.graded(recipe) if Path(recipe).name == recipe else ():
            if (folder / bundle).is_file():
                try:
                    return BundleShelf(folder).member(bundle, "frame.png")
                except BundleError as error:
                    raise NoSuchPictureError(str(error)) from error
        msg = f"there is no graded picture {bundle!r:.90} of recipe {recipe!r:.60}"
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
