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
from slabcell.vision.result import LocateResult

__all__ = ["Eyes", "Picture"]

Picture = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]


class Eyes(Protocol):
    """Finds parts, and measures laid ones."""

    def locate(
        self, image: Picture, calibration: Calibration, recipe: Recipe, *, area_mm: Polygon, free_slots: Collection[int]
    ) -> LocateResult:
        """Return what lies in an area of the table and fits the free slots."""
        ...

    def measure(
        self,
        image: Picture,
        calibration: Calibration,
        recipe: Recipe,
        *,
        assembly_in_table: RigidTransform2D,
        slots: Collection[int],
    ) -> tuple[PlacementRecord, ...]:
        """Return how the slabs lie in these slots, in the order of the slots."""
        ...
