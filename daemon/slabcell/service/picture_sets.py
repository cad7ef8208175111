"""Which pictures are kept to tune on?  Sets of them: one folder each in the state directory, of plain picture files.

A set is a name and picture files: what the camera saw in difficult light, with other stone, on another table.  They are
kept until somebody removes them, and bounded in number and size.
"""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Final

from slabcell.catalogue import Fault
from slabcell.errors import SlabcellError, UsageError
from slabcell.images import image_size
from slabcell.service.atomic import write_atomically

__all__ = ["NoSuchPictureError", "PictureSets", "StoredPicture", "StoredSet"]

MAX_SETS: Final = 40
MAX_PICTURES: Final = 200
MAX_TOTAL_BYTES: Final = 4 << 30
SET_NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]{0,39}")
PICTURE_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}")
_ENDINGS: Final = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff"})
_SIGNATURES: Final = {b"\x89PNG": ".png", b"\xff\xd8": ".jpg"}


class NoSuchPictureError(SlabcellError):
    """There is no such picture, or not any more."""


@dataclass(frozen=True, slots=True)
class StoredPicture:
    """One file of a set."""

    name: str
    bytes: int


@dataclass(frozen=True, slots=True)
class StoredSet:
    """One set, its pictures by name."""

    name: str
    pictures: tuple[StoredPicture, ...]


class PictureSets:
    """The sets of one cell.  Methods block: run them in a thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()

    def sets(self) -> list[StoredSet]:
        """Return every set by name; none where nothing was kept yet."""
        if not self._folder.is_dir():
            return []
        folders = sorted(item for item in self._folder.iterdir() if item.is_dir() and SET_NAME.fullmatch(item.name))
        return [StoredSet(item.name, self._pictures(item)) for item in folders[:MAX_SETS]]

    def path(self, set_name: str, picture: str) -> Path:
        """Return the file of a picture.  Raises NoSuchPictureError."""
        path = self._folder / set_name / picture
        if not (SET_NAME.fullmatch(set_name) and _is_picture(picture) and path.is_file()):
            msg = f"there is no picture {picture!r:.90} in set {set_name!r:.50}"
            raise NoSuchPictureError(msg)
        return path

    def add(self, set_name: str, raw: bytes, name: str = "") -> str:
        """Keep a picture file in a set, which begins with its first; return the name of the file.

        ``name`` is what people call it, without an ending; empty: the moment.  The same picture is kept once.  Raises
        UsageError for a name that is none or a set that is full, ImageError, and SlabcellError if it cannot be written.
        """
        digest = sha256(raw).hexdigest()[:8]
        stem = f"{name or f'{datetime.now(UTC):%Y%m%dT%H%M%S}'}-{digest}"
        if not SET_NAME.fullmatch(set_name):
            msg = f"set {set_name!r:.50}: a name is 1 to 40 of a-z 0-9 - _, and begins with a letter or digit"
            raise UsageError(msg)
        if not PICTURE_NAME.fullmatch(stem):
            msg = f"picture {name!r:.60}: a name is at most 60 of A-Z a-z 0-9 . - _, and begins with a letter or digit"
            raise UsageError(msg)
        image_size(raw, "the picture")
        ending = next((ending for sign, ending in _SIGNATURES.items() if raw.startswith(sign)), ".tif")
        folder = self._folder / set_name
        with self._lock:
            known = self._require_room(set_name, len(raw))
            there = next((item.name for item in known if Path(item.name).stem.endswith(f"-{digest}")), None)
            if there is not None:
                return there
            try:
                folder.mkdir(parents=True, exist_ok=True)
                write_atomically(folder / f"{stem}{ending}", raw)
            except OSError as error:
                msg = f"{folder}: cannot be written: {error.strerror}"
                raise SlabcellError(msg, number=Fault.STATE_UNWRITABLE) from error
        return f"{stem}{ending}"

    def remove(self, set_name: str, picture: str) -> None:
        """Remove a picture; a set ends with its last.  Raises NoSuchPictureError."""
        with self._lock:
            path = self.path(set_name, picture)
            path.unlink()
            if not any(path.parent.iterdir()):
                path.parent.rmdir()

    def _require_room(self, set_name: str, size: int) -> tuple[StoredPicture, ...]:
        """Return what is in a set already.  Raises UsageError unless one more picture has room."""
        sets = self.sets()
        known = next((item.pictures for item in sets if item.name == set_name), None)
        if known is None and len(sets) >= MAX_SETS:
            msg = f"there are {len(sets)} sets, the limit: remove the pictures of one, or use one that is there"
            raise UsageError(msg)
        if len(known or ()) >= MAX_PICTURES:
            msg = f"set {set_name} holds {MAX_PICTURES} pictures, the limit: remove some"
            raise UsageError(msg)
        total = sum(picture.bytes for item in sets for picture in item.pictures)
        if total + size > MAX_TOTAL_BYTES:
            msg = f"the sets hold {total >> 20} MiB of pictures, the limit is {MAX_TOTAL_BYTES >> 20}: remove some"
            raise UsageError(msg)
        return known or ()

    def _pictures(self, folder: Path) -> tuple[StoredPicture, ...]:
        found = sorted(item for item in folder.iterdir() if item.is_file() and _is_picture(item.name))
        return tuple(StoredPicture(item.name, item.stat().st_size) for item in found[:MAX_PICTURES])


def _is_picture(name: str) -> bool:
    return bool(PICTURE_NAME.fullmatch(name)) and Path(name).suffix.lower() in _ENDINGS
