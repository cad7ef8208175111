"""What does the cell work with, and what follows from it for every picture?  Recipe, calibration, settings and arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from slabcell.calibration.file import from_document as calibration_from_document
from slabcell.calibration.file import to_document as calibration_to_document
from slabcell.calibration.model import Calibration
from slabcell.cell.bundle import BundleContext
from slabcell.cell.eyes import Eyes, HouseEyes
from slabcell.cell.planning import Planner
from slabcell.cell.settings import CellSettings
from slabcell.recipe import Recipe
from slabcell_drivers.robot.arm import ArmModel

__all__ = ["Outfit"]


@dataclass(frozen=True, slots=True)
class Outfit:
    """Everything that changes together, between two cycles; ``eyes`` are there when a calibration is."""

    recipe: Recipe
    calibration: Calibration | None
    settings: CellSettings
    arm: ArmModel
    eyes: Eyes | None
    planner: Planner

    @classmethod
    def of(
        cls,
        recipe: Recipe,
        calibration: Calibration | None,
        settings: CellSettings,
        arm: ArmModel,
        *,
        eyes: Eyes | None = None,
    ) -> Self:
        """Make it ready, which takes its time.  Raises ModelError for a model that cannot be used."""
        if calibration is not None:
            # As a bundle holds it, to the last bit: the way arrays lie in memory changes rounding.
            calibration = calibration_from_document(calibration_to_document(calibration), "the calibration")
            eyes = eyes or HouseEyes(calibration, recipe)
        return cls(recipe, calibration, settings, arm, eyes, Planner(recipe, settings, arm))

    def context(self) -> BundleContext | None:
        """Return what bundles need; without a calibration there is no cycle to be kept."""
        if self.calibration is None:
            return None
        return BundleContext(self.recipe, self.calibration, self.settings, self.arm)
