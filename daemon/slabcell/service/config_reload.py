"""Which keys take effect while the cell runs, and how?  At SIGHUP the configuration is read anew.

What may be reloaded stands in `RELOADABLE`, and nowhere else; any other change waits for a restart, and is named.  A
configuration with a fault changes nothing.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import structlog

from slabcell.cell.cell import Cell
from slabcell.errors import SlabcellError
from slabcell.service.builder import cell_settings
from slabcell.service.config import CellConfig
from slabcell.service.config_layers import leaves, load_config

__all__ = ["RELOADABLE", "Reloader", "changed_keys", "is_reloadable"]

RELOADABLE: Final = (
    "camera.timeout_s",
    "table.pick_area",
    "table.forbidden",
    "robot.gripper_radius_mm",
    "planning.attempts_per_slot",
    "planning.vision_timeout_s",
    "verification.tolerance_mm",
    "verification.tolerance_deg",
    "verification.check_assembly_is_empty",
    "verification.correct_systematic",
)
"""They decide on the next trigger, and on nothing that is open: no device, no file, no pose that was offered."""

RETRY_S: Final = 0.5
PATIENCE_S: Final = 60.0

_log = structlog.get_logger(__name__)


def is_reloadable(key: str) -> bool:
    """Return whether a dotted key takes effect without a restart."""
    return key in RELOADABLE


def changed_keys(before: CellConfig, after: CellConfig) -> list[str]:
    """Return the keys, dotted, whose values differ."""
    old = dict(leaves(before.model_dump(mode="json")))
    new = dict(leaves(after.model_dump(mode="json")))
    return [".".join(key) for key in {**old, **new} if old.get(key) != new.get(key)]


class Reloader:
    """Reads the configuration of a running cell anew.  ``told`` gets what came of it, for events."""

    def __init__(
        self, path: Path, config: CellConfig, cell: Cell, pending: list[str], told: Callable[[dict[str, Any]], None]
    ) -> None:
        self._path = path
        self._config = config
        self._cell = cell
        self._pending = pending
        self._told = told
        self._turn = asyncio.Lock()

    async def reload(self) -> None:
        """Take over what may be; what may not is listed as pending.  Never raises SlabcellError."""
        async with self._turn:
            try:
                config = await asyncio.to_thread(load_config, self._path)
                changed = changed_keys(self._config, config)
                now = [key for key in changed if is_reloadable(key)]
                if now:
                    await self._change(config)
            except SlabcellError as error:
                _log.error("configuration not reloaded: nothing is changed", detail=str(error))
                self._told({"reloaded": [], "pending": list(self._pending), "error": str(error)})
                return
            self._pending[:] = [key for key in changed if not is_reloadable(key)]
            self._config = _taken_over(self._config, config)
            _log.info("configuration reloaded", reloaded=now, pending=self._pending)
            self._told({"reloaded": now, "pending": list(self._pending), "error": None})

    async def _change(self, config: CellConfig) -> None:
        """Change the cell's settings, as soon as no cycle is on its way."""
        settings = cell_settings(_taken_over(self._config, config))
        deadline_s = asyncio.get_running_loop().time() + PATIENCE_S
        while True:
            try:
                await self._cell.change(settings=settings)
            except SlabcellError:
                if asyncio.get_running_loop().time() >= deadline_s:
                    raise
                await asyncio.sleep(RETRY_S)
            else:
                return


def _taken_over(before: CellConfig, after: CellConfig) -> CellConfig:
    """Return the running configuration with the reloadable values of another."""
    content, new = before.model_dump(), after.model_dump()
    for key in RELOADABLE:
        *tables, name = key.split(".")
        here, there = content, new
        for table in tables:
            here, there = here[table], there[table]
        here[name] = there[name]
    return CellConfig.model_validate(content)
