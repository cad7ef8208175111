"""Which implementation does the heavy work?  The compiled kernel where there is one, else the references in NumPy.

The kernel is plain C (`native`), compiled when the package is built or installed, if a C compiler is there.  Both give
the same numbers; the kernel is some ten times faster.  `implementation` says which one is used.
"""

from collections.abc import Sequence
from functools import cache
from typing import Protocol

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision import (
    contours,
    edge_profile,
    edge_projection,
    local_map,
    matching,
    part_poses,
    pose_solver,
    registration,
    shapes,
    survey,
    walls,
)
from slabcell.vision.contours import Contours
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses, ProjectedEdges
from slabcell.vision.local_map import LocalMaps
from slabcell.vision.matching import Candidate, MatchLimits
from slabcell.vision.outline import Rings
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.part_poses import PartPoses, SlotTable
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PixelTable, PlaneView
from slabcell.vision.pose_solver import Measured, Solution
from slabcell.vision.registration import Registration
from slabcell.vision.shapes import Shapes
from slabcell.vision.survey import Survey

__all__ = ["Engine", "NumpyEngine", "engine", "implementation", "maps_of"]

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]
Index = npt.NDArray[np.int64]


class Engine(Protocol):
    """The steps that take the time, in one implementation.  Each returns what the function of its name returns."""

    @property
    def name(self) -> str:
        """Return ``native`` or ``numpy``."""
        ...

    def survey(self, picture: Picture) -> Survey:
        """See `survey.survey`."""
        ...

    def trace(
        self, picture: Picture, level: float, *, dark: bool, interpolate: bool, min_area_px: float, row_shift: int = 0
    ) -> Contours:
        """See `contours.trace`."""
        ...

    def to_plane(self, table: PixelTable, pixels: Points) -> Points:
        """See `plane.PixelTable.at`."""
        ...

    def strip_walls(self, plane: PlaneView, seen: Rings) -> Rings:
        """See `walls.strip_walls`."""
        ...

    def describe(self, rings: Rings) -> Shapes:
        """See `shapes.describe`."""
        ...

    def describe_pixels(self, table: PixelTable, pixels: Points, begins: Index, ends: Index) -> Shapes:
        """See `shapes.describe_pixels`."""
        ...

    def find_candidates(
        self, blobs: Shapes, slots: Shapes, limits: MatchLimits, allowed: npt.NDArray[np.bool_] | None = None
    ) -> list[Candidate]:
        """See `matching.find_candidates`."""
        ...

    def map_locally(self, plane: PlaneView, centre: Points, size: Floats) -> LocalMaps:
        """See `local_map.map_locally`."""
        ...

    def to_pixels(self, plane: PlaneView, points: Points) -> Points:
        """See `plane.PlaneView.to_pixels`."""
        ...

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """See `edge_projection.project`."""
        ...

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """See `edge_profile.measure_edges`."""
        ...

    def solve(self, measured: Measured, prior: float) -> Solution:
        """See `pose_solver.solve`."""
        ...

    def register(
        self, grey: Grey, plane: PlaneView, outlines: OutlineSet, candidates: Sequence[Candidate], *, rough: bool
    ) -> list[Registration]:
        """See `registration.register`."""
        ...

    def part_poses(self, plane: PlaneView, slots: SlotTable, chosen: Sequence[Registration]) -> PartPoses:
        """See `part_poses.part_poses`."""
        ...


class NumpyEngine:
    """The references."""

    name = "numpy"

    def survey(self, picture: Picture) -> Survey:
        """See `survey.survey`."""
        return survey.survey(picture)

    def trace(
        self, picture: Picture, level: float, *, dark: bool, interpolate: bool, min_area_px: float, row_shift: int = 0
    ) -> Contours:
        """See `contours.trace`."""
        return contours.trace(
            picture, level, dark=dark, interpolate=interpolate, min_area_px=min_area_px, row_shift=row_shift
        )

    def to_plane(self, table: PixelTable, pixels: Points) -> Points:
        """See `plane.PixelTable.at`."""
        return table.at(pixels)

    def strip_walls(self, plane: PlaneView, seen: Rings) -> Rings:
        """See `walls.strip_walls`."""
        return walls.strip_walls(plane, seen)

    def describe(self, rings: Rings) -> Shapes:
        """See `shapes.describe`."""
        return shapes.describe(rings)

    def describe_pixels(self, table: PixelTable, pixels: Points, begins: Index, ends: Index) -> Shapes:
        """See `shapes.describe_pixels`."""
        return shapes.describe_pixels(table, pixels, begins, ends)

    def find_candidates(
        self, blobs: Shapes, slots: Shapes, limits: MatchLimits, allowed: npt.NDArray[np.bool_] | None = None
    ) -> list[Candidate]:
        """See `matching.find_candidates`."""
        return matching.find_candidates(blobs, slots, limits, allowed)

    def map_locally(self, plane: PlaneView, centre: Points, size: Floats) -> LocalMaps:
        """See `local_map.map_locally`."""
        return local_map.map_locally(plane, centre, size)

    def to_pixels(self, plane: PlaneView, points: Points) -> Points:
        """See `plane.PlaneView.to_pixels`."""
        return plane.to_pixels(points)

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """See `edge_projection.project`."""
        return edge_projection.project(outlines, maps, poses, mirrored=mirrored)

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """See `edge_profile.measure_edges`."""
        return edge_profile.measure_edges(grey, lines, model)

    def solve(self, measured: Measured, prior: float) -> Solution:
        """See `pose_solver.solve`."""
        return pose_solver.solve(measured, prior)

    def register(
        self, grey: Grey, plane: PlaneView, outlines: OutlineSet, candidates: Sequence[Candidate], *, rough: bool
    ) -> list[Registration]:
        """See `registration.register`."""
        return registration.register(grey, plane, outlines, candidates, rough=rough)

    def part_poses(self, plane: PlaneView, slots: SlotTable, chosen: Sequence[Registration]) -> PartPoses:
        """See `part_poses.part_poses`."""
        return part_poses.part_poses(plane, slots, chosen)


def implementation() -> str:
    """Return ``native`` where the compiled kernel is used, ``numpy`` where the references are."""
    return engine().name


@cache
def engine() -> Engine:
    """Return the fastest implementation that is there."""
    from slabcell.vision.native import NativeEngine  # noqa: PLC0415 - it knows the types of this module's neighbours

    try:
        return NativeEngine()
    except (OSError, AttributeError, ValueError):
        return NumpyEngine()


def maps_of(plane: PlaneView, outlines: OutlineSet, position: Points) -> LocalMaps:
    """Return maps that hold where the outlines lie, each at its position (n, 2), and a little around."""
    return engine().map_locally(plane, position, outlines.reaches_mm + local_map.MARGIN_PX * plane.mm_per_px)
