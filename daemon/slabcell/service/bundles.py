"""Which kept cycle is meant?  Finds the bundle of a cycle, for the pictures and files that people ask for."""

from __future__ import annotations

import re
import zipfile
import zlib
from pathlib import Path
from typing import Final

from slabcell.cell.bundle_file import BundleError

__all__ = ["BundleShelf"]

MAX_MEMBER_BYTES: Final = 256 << 20
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{1,160}\.zip")
MEMBERS: Final = {
    "frame.png": "image/png",
    "result.json": "application/json",
    "overlay.json": "application/json",
    "transcript.json": "application/json",
    "telegrams.json": "application/json",
    "as-built.json": "application/json",
    "as-built.csv": "text/csv",
    "as-built.svg": "image/svg+xml",
}


class BundleShelf:
    """The folder of the bundles.  Methods block: run them in a thread."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, name: str) -> Path:
        """Return the file of a bundle.  Raises BundleError if there is none, any more or at all."""
        path = self._folder / name
        if not _NAME.fullmatch(name) or not path.is_file():
            msg = f"bundle {name or 'of this cycle'}: is not kept, or not any more"
            raise BundleError(msg)
        return path

    def member(self, name: str, member: str) -> bytes:
        """Return one file out of a bundle.  Raises BundleError."""
        path = self.path(name)
        try:
            with zipfile.ZipFile(path) as archive:
                if member not in archive.namelist():
                    msg = f"{name}: holds no {member}"
                    raise BundleError(msg)
                with archive.open(member) as stream:
                    raw = stream.read(MAX_MEMBER_BYTES + 1)
        except (OSError, zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, RuntimeError) as error:
            msg = f"{name}: cannot be read: {error}"
            raise BundleError(msg) from error
        if len(raw) > MAX_MEMBER_BYTES:
            msg = f"{name}: {member} is larger than {MAX_MEMBER_BYTES >> 20} MiB"
            raise BundleError(msg)
        return raw
