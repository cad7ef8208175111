"""How does a cell come to life from its parts?  Ledger, cell and bundles, opened and closed in their order."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from pathlib import Path

from slabcell.calibration import Calibration
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon
from slabcell.recipe import Recipe
from slabcell.service.config import CellConfig
from slabcell_drivers.camera import Camera
from slabcell_drivers.robot.arm import ArmModel

__all__ = ["CellParts", "cell_settings", "open_cell"]


@dataclass(frozen=True, slots=True)
class CellParts:
    """What a cell is made of, read and checked."""

    calibration: Calibration
    recipe: Recipe
    arm: ArmModel
    settings: CellSettings


def cell_settings(config: CellConfig) -> CellSettings:
    """Return what the configuration fixes about the cell.  Raises ConfigurationError for bases that are not level."""
    return CellSettings(
        pick_base=config.robot.pick_base.to_frame(),
        place_base=config.robot.place_base.to_frame(),
        tool=config.robot.tool.to_frame(),
        pick_area=Polygon.from_points(config.table.pick_area),
        camera_timeout_s=config.camera.timeout_s,
    )


@contextlib.asynccontextmanager
async def open_cell(parts: CellParts, camera: Camera, folder: Path) -> AsyncGenerator[tuple[Cell, Ledger]]:
    """Give a cell that is ready, and its ledger; both are in ``folder`` with the bundles.

    The camera need not be open yet; it is the caller's to open and to close.  Raises LedgerError or CalibrationError.
    """
    ledger = await Ledger.open(folder / "ledger.sqlite")
    try:
        cell = Cell(
            camera,
            parts.calibration,
            parts.recipe,
            arm=parts.arm,
            settings=parts.settings,
            ledger=ledger,
            bundles=BundleWriter(folder / "bundles"),
        )
        await cell.start()
        try:
            yield cell, ledger
        finally:
            await cell.stop()
    finally:
        await ledger.close()
