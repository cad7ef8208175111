"""Which files are served as they are?  Style, scripts and icons, read once; nothing else on the disk can be asked for.

The address holds a digest of all of them: a browser may keep each for ever, and modules that import each other are
always of one version.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

__all__ = ["StaticFile", "StaticFiles", "static_files"]

ROOM: Final = Path(__file__).parent / "static"
TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".LICENSE": "text/plain; charset=utf-8",
}


@dataclass(frozen=True, slots=True)
class StaticFile:
    """One file."""

    content: bytes
    media_type: str


class StaticFiles:
    """All of them, by the path below the folder."""

    def __init__(self) -> None:
        paths = sorted(path for path in ROOM.rglob("*") if path.is_file())
        self.files = {
            path.relative_to(ROOM).as_posix(): StaticFile(path.read_bytes(), TYPES[path.suffix]) for path in paths
        }
        digest = hashlib.sha256()
        for name, file in self.files.items():
            digest.update(name.encode() + b"\0" + file.content + b"\0")
        self.version = digest.hexdigest()[:12]

    def url(self, name: str) -> str:
        """Return the address of a file.  Raises KeyError if there is none."""
        if name not in self.files:
            raise KeyError(name)
        return f"/static/{self.version}/{name}"


@cache
def static_files() -> StaticFiles:
    """Return the files of this process."""
    return StaticFiles()
