"""How does a cell come to life from its parts?  Ledger, cell and bundles, opened and closed in their order."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field
from pathlib import Path

from slabcell.calibration import Calibration, load_calibration
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.retention import DAY_S, Retention
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon
from slabcell.recipe import Recipe, load_recipe
from slabcell.service.config import CellConfig
from slabcell_drivers.camera import Camera
from slabcell_drivers.robot.arm import ArmModel, arm_by_name

__all__ = ["CellParts", "cell_settings", "open_cell", "read_parts", "retention"]


@dataclass(frozen=True, slots=True)
class CellParts:
    """What a cell is made of, read and checked.  A new cell has no calibration yet."""

    calibration: Calibration | None
    recipe: Recipe
    arm: ArmModel
    settings: CellSettings
    retention: Retention = field(default_factory=Retention)


def cell_settings(config: CellConfig) -> CellSettings:
    """Return what the configuration fixes about the cell.  Raises ConfigurationError for bases that are not level."""
    return CellSettings(
        pick_base=config.robot.pick_base.to_frame(),
        place_base=config.robot.place_base.to_frame(),
        tool=config.robot.tool.to_frame(),
        pick_area=Polygon.from_points(config.table.pick_area),
        forbidden=tuple(Polygon.from_points(zone) for zone in config.table.forbidden),
        gripper_radius_mm=config.robot.gripper_radius_mm,
        approach_mm=config.robot.krl.approach_mm,
        tolerance_mm=config.verification.tolerance_mm,
        tolerance_deg=config.verification.tolerance_deg,
        attempts_per_slot=config.planning.attempts_per_slot,
        check_assembly_is_empty=config.verification.check_assembly_is_empty,
        correct_systematic=config.verification.correct_systematic,
        camera_timeout_s=config.camera.timeout_s,
        vision_timeout_s=config.planning.vision_timeout_s,
    )


def retention(config: CellConfig) -> Retention:
    """Return for how long bundles are kept."""
    limits = config.bundles
    return Retention(
        max_bytes=limits.max_mib << 20,
        max_age_s=limits.max_days * DAY_S,
        failures_max_bytes=limits.failures_max_mib << 20,
        failures_max_age_s=limits.failures_max_days * DAY_S,
        min_free_bytes=limits.min_free_mib << 20,
    )


def read_parts(config: CellConfig) -> CellParts:
    """Return what the files of a configuration say.

    A calibration that is not there yet is none: the cell says so, and its first one is made with its own camera.  One
    that is there must be whole.  Raises ConfigurationError, CalibrationError, RecipeError or TemplateError.
    """
    return CellParts(
        _calibration(config.calibration),
        load_recipe(config.recipe),
        arm_by_name(config.robot.model),
        cell_settings(config),
        retention(config),
    )


def _calibration(path: Path | None) -> Calibration | None:
    if path is None or not path.exists():
        return None
    calibration = load_calibration(path)
    calibration.require_plane()
    return calibration


@contextlib.asynccontextmanager
async def open_cell(parts: CellParts, camera: Camera, folder: Path) -> AsyncGenerator[tuple[Cell, Ledger]]:
    """Give a cell that is ready, or waits for its calibration, and its ledger; both are in ``folder`` with the bundles.

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
            bundles=BundleWriter(folder / "bundles", retention=parts.retention),
        )
        await cell.start()
        try:
            yield cell, ledger
        finally:
            await cell.stop()
    finally:
        await ledger.close()
