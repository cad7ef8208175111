"""What of a calibration and a recipe is the same for every picture?  Made once, when first asked for."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import shapely

from slabcell.calibration.model import Calibration
from slabcell.geometry import Polygon
from slabcell.recipe import Recipe
from slabcell.vision.ambiguity import kinds_of
from slabcell.vision.describe import describe_slots
from slabcell.vision.edges import EdgePieces, cut_edges
from slabcell.vision.grasp import Grasp, choose_grasp
from slabcell.vision.matching import MatchLimits
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.part_poses import SlotTable
from slabcell.vision.plane import PlaneView
from slabcell.vision.shapes import Shapes
from slabcell.vision.symmetry import symmetry_order
from slabcell.vision.walls import MIN_WALL_PX, widest_wall_px

__all__ = ["Prepared"]

Complex = npt.NDArray[np.complex128]

# Outlines count as alike when no corner leaves the other by more than this in pixels, or by the recipe's alike_mm,
# whichever is more.
ALIKE_PX = 0.15
# On so many of the rows that are searched every slab must lie.
ROWS = 4
# What the whole-outline registration may be off before the edges are measured: in pixels, and in parts of the size.
COARSE_PX = 1.5
COARSE_SHARE = 0.01
# What the threshold's outline scatters at least.
FLOOR_PX = 0.1
# ... and of the width of the walls that are seen, which are taken off only roughly.
WALL_SHARE = 0.35


@dataclass(frozen=True, eq=False)
class Prepared:
    """Everything about a calibration and a recipe that does not change from picture to picture."""

    calibration: Calibration
    recipe: Recipe

    @cached_property
    def plane(self) -> PlaneView:
        """The plane of the slabs' upper faces.  Raises CalibrationError where the picture does not see it."""
        self.calibration.require_plane()
        view = PlaneView(self.calibration, self.recipe.thickness_mm)
        _ = view.usable
        return view

    @cached_property
    def table(self) -> PlaneView:
        """The work plane.  Raises CalibrationError where the picture does not see it."""
        view = PlaneView(self.calibration, 0.0)
        _ = view.usable
        return view

    @cached_property
    def slots(self) -> tuple[Polygon, ...]:
        """The slots of the template, assembly frame."""
        return self.recipe.template.slots

    @cached_property
    def middles(self) -> Complex:
        """The slots' centroids as x + iy, (slots,)."""
        return np.array([complex(*slot.centroid) for slot in self.slots])

    @cached_property
    def slot_table(self) -> SlotTable:
        """The slots, as parts' poses are worked out from them."""
        nowhere = complex(math.nan, math.nan)
        grasps = [nowhere if grasp.point is None else complex(*grasp.point) for grasp in self.grasps]
        corners = np.concatenate([slot.vertices for slot in self.slots])
        starts = np.concatenate([[0], np.cumsum([len(slot.vertices) for slot in self.slots])])
        return SlotTable(
            self.middles,
            np.array(grasps, np.complex128),
            np.array(self.orders, np.float64),
            corners[:, 0] + 1j * corners[:, 1],
            starts.astype(np.int64),
        )

    @cached_property
    def shapes(self) -> Shapes:
        """Features of the slots."""
        return describe_slots(self.slots)

    @cached_property
    def sorted_areas_mm2(self) -> list[float]:
        """The slots' areas, the smallest first."""
        return sorted(self.shapes.area_mm2.tolist())

    @cached_property
    def row_shift(self) -> int:
        """Slabs are looked for on every 2^row_shift-th row of a picture, which meets the thinnest several times."""
        corners = (shapely.get_coordinates(shapely.minimum_rotated_rectangle(slot.shape)) for slot in self.slots)
        sides = (np.hypot(*np.diff(box, axis=0)[:2].T).min() for box in corners)
        thinnest_px = float(min(sides)) / self.plane.mm_per_px
        return max(shift for shift in (0, 1, 2) if shift == 0 or thinnest_px >= ROWS << shift)

    @cached_property
    def pieces(self) -> tuple[EdgePieces, ...]:
        """Measurable pieces of the slots' outlines."""
        return tuple(cut_edges(slot, self.plane.mm_per_px) for slot in self.slots)

    @property
    def _alike_mm(self) -> float:
        return max(self.recipe.matching.alike_mm, ALIKE_PX * self.plane.mm_per_px)

    @cached_property
    def outlines(self) -> OutlineSet:
        """The slots' outlines, as they are registered."""
        return OutlineSet(self.pieces, np.column_stack([self.middles.real, self.middles.imag]))

    @cached_property
    def orders(self) -> tuple[int, ...]:
        """Rotational symmetry of each slot."""
        return tuple(symmetry_order(slot, self._alike_mm) for slot in self.slots)

    @cached_property
    def limits(self) -> MatchLimits:
        """What blobs are compared with which slots, and how far off they may be."""
        scale = self.plane.mm_per_px
        distance = (
            (COARSE_PX + WALL_SHARE * self.widest_wall_px) * scale
            + COARSE_SHARE * np.sqrt(self.shapes.area_mm2)
            + self.recipe.matching.max_residual_mm
        )
        return MatchLimits(
            distance_mm=distance,
            symmetry_order=self.orders,
            margin_mm=0.5 * scale,
            floor_mm=FLOOR_PX * scale,
            area=self.recipe.matching.area_tolerance,
        )

    @cached_property
    def kinds(self) -> tuple[int, ...]:
        """A number for each slot; slots of the same outline have the same."""
        return kinds_of(self.slots, self._alike_mm)

    @cached_property
    def grasps(self) -> tuple[Grasp, ...]:
        """Where each slot's slab is grasped, assembly frame."""
        return tuple(choose_grasp(slot, self.recipe.grasp, number) for number, slot in enumerate(self.slots))

    @cached_property
    def widest_wall_px(self) -> float:
        """Width in the picture of the widest wall that can be seen."""
        return widest_wall_px(self.plane)

    @property
    def walls(self) -> bool:
        """Whether the slabs' walls are seen, wide enough to matter."""
        return self.widest_wall_px > MIN_WALL_PX
