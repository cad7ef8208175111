"""Which template does the cell lay now?  Asked of the daemon once for each template."""

from __future__ import annotations

from typing import Any

from slabcell.hmi.cell_api import CellApi, Json
from slabcell.hmi.drawing import Drawing, draw_template

__all__ = ["ActiveTemplate"]


class ActiveTemplate:
    """The polygons of the active recipe."""

    def __init__(self, api: CellApi) -> None:
        self._api = api
        self._known: tuple[str, list[Any]] = ("", [])

    async def drawing(self, status: Json, label: str) -> Drawing | None:
        """Return the template drawn with what the present job has laid.  Raises SlabcellError."""
        wanted = str(status["template_sha256"])
        if self._known[0] != wanted:
            template = (await self._api.get("/v1/recipes/active"))["recipe"]["template"]
            self._known = (str(template["sha256"]), template["slots"])
        polygons = self._known[1]
        if not polygons:
            return None
        job = status["job"]
        slots = job["slots"] if job is not None and job["template_sha256"] == wanted else None
        return draw_template(polygons, slots, label)
