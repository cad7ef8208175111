"""What do people tune and calibrate with?  The bench, the pictures that they work on, and what it left."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from slabcell.service.background import Background
from slabcell.service.bench.workbench import Workbench
from slabcell.service.expiring import Expiring
from slabcell.service.pictures import Pictures
from slabcell.service.views import Views

__all__ = ["Preview", "Studio"]

MAX_PREVIEWS: Final = 8
MAX_PREVIEW_BYTES: Final = 160 << 20
PREVIEW_S: Final = 600.0


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """What one run of the vision left to look at: files by name."""

    files: Mapping[str, bytes]

    @property
    def size(self) -> int:
        """How many bytes they are."""
        return sum(len(content) for content in self.files.values())


def _previews() -> Expiring[Preview]:
    return Expiring(number=MAX_PREVIEWS, total_bytes=MAX_PREVIEW_BYTES, kept_s=PREVIEW_S)


@dataclass(slots=True)
class Studio:
    """What one daemon has of it."""

    bench: Workbench
    pictures: Pictures
    background: Background = field(default_factory=Background)
    views: Views = field(default_factory=Views)
    previews: Expiring[Preview] = field(default_factory=_previews)

    def keep(self, preview: Preview) -> str:
        """Keep a preview for a while; return its id."""
        name = secrets.token_hex(6)
        self.previews.add(name, preview, preview.size)
        return name

    async def close(self) -> None:
        """End the bench, and forget what it left."""
        await self.background.close()
        self.previews.clear()
        self.pictures.uploads.clear()
        await self.bench.close()
