"""What does the cell ask of the vision?  A port of two questions, and the vision of the house behind it.

The calls compute and block; the cell runs them in a worker thread.
"""

from collections.abc import Collection
from typing import Protocol

import numpy as np
import numpy.typing as npt

from slabcell.calibration.model import Calibration
from slabcell.cell.records import PlacementRecord
from slabcell.geometry import Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.vision.layers import LayeredLocator
from slabcell.vision.result import LocateResult

__all__ = ["Eyes", "HouseEyes", "Picture"]

Picture = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class Eyes(Protocol):
    """Finds parts, and measures laid ones, of one product with one camera."""

    def locate(self, image: Picture, *, area_mm: Polygon, free_slots: Collection[int]) -> LocateResult:
        """Return what lies in an area of the table and fits the free slots."""
        ...

    def measure(
        self, image: Picture, *, assembly_in_table: RigidTransform2D, slots: Collection[int]
    ) -> tuple[PlacementRecord, ...]:
        """Return how the slabs lie in these slots, in the order of the slots."""
        ...


class HouseEyes:
    """The vision of slabcell.  What does not change from picture to picture is computed once."""

    def __init__(self, calibration: Calibration, recipe: Recipe) -> None:
        """Open the recipe's promptable model, if it names one; raises ModelError now, not at the first cycle."""
        self._locator = LayeredLocator(calibration, recipe)
        self._locator.open_model()

    def locate(self, image: Picture, *, area_mm: Polygon, free_slots: Collection[int]) -> LocateResult:
        """Return what lies in an area of the table and fits the free slots."""
        return self._locator.locate(image, area_mm=area_mm, free_slots=free_slots)

    def measure(
        self, image: Picture, *, assembly_in_table: RigidTransform2D, slots: Collection[int]
    ) -> tuple[PlacementRecord, ...]:
        """Return how the slabs lie in these slots, in the order of the slots."""
        placements = self._locator.measure(image, assembly_in_table=assembly_in_table, slots=slots)
        return tuple(
            PlacementRecord(item.slot, item.found, item.dx_mm, item.dy_mm, item.da_deg, item.residual_mm)
            for item in placements
        )
