"""How do pixels and the upper faces of slabs correspond, quickly?  A calibration, sampled for one height.

Contours need a tenth of a pixel and are many points: they go through a table sampled from the calibration.  Edges that
are measured go through the calibration itself.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from slabcell.calibration.model import Calibration
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["GRID_PX", "ForwardTable", "PixelTable", "PlaneView"]

# Distance of the samples in pixels; between them the mapping is bilinear, which is good to 0.05 px for usual lenses.
GRID_PX: Final = 24
# The table from the plane to pixels reaches this share of the view beyond it on every side.
BEYOND: Final = 0.5
# It is cubic between its samples, and not used where that is worse than this or takes too many.
FORWARD_PX: Final = 1e-3
MAX_SAMPLES: Final = 300_000
MIN_STEPS: Final = 4
# Sizes of a pixel, and distances on the table, that a cell can have.
SMALLEST_PX_MM, LARGEST_PX_MM = 1e-3, 1e2
FARTHEST_MM = 1e6
# By how much a point of the table may be seen beside the pixel that it was taken from.
ROUND_TRIP_PX = 0.5


@dataclass(frozen=True, eq=False)
class PixelTable:
    """``mm`` (rows, columns, 2): point of the plane at every ``pitch_px``-th pixel."""

    mm: Points
    pitch_px: float

    def at(self, pixels: Points) -> Points:
        """Return plane points in mm for pixels (n, 2), bilinear between the samples.  The reference of `kernel`."""
        rows, columns, _ = self.mm.shape
        cells = pixels / self.pitch_px
        whole = np.floor(cells).astype(np.intp)
        column = np.clip(whole[:, 0], 0, columns - 2)
        row = np.clip(whole[:, 1], 0, rows - 2)
        right = (cells[:, 0] - column)[:, None]
        down = (cells[:, 1] - row)[:, None]
        upper = self.mm[row, column] * (1 - right) + self.mm[row, column + 1] * right
        lower = self.mm[row + 1, column] * (1 - right) + self.mm[row + 1, column + 1] * right
        return upper * (1 - down) + lower * down


@dataclass(frozen=True, eq=False)
class ForwardTable:
    """``pixels`` (rows, columns, 4): where points of the plane, and of the work plane below them, are seen.

    The first is at ``x_mm``, ``y_mm``; they lie ``pitch_mm`` apart.  ``flat``: both planes are one.
    """

    pixels: Points
    x_mm: float
    y_mm: float
    pitch_mm: float
    flat: bool


@dataclass(frozen=True, eq=False)
class PlaneView:
    """The plane z = ``height_mm`` as one camera sees it."""

    calibration: Calibration
    height_mm: float

    @cached_property
    def grid(self) -> PixelTable:
        """The plane at evenly spaced pixels of the whole picture."""
        columns = self.calibration.camera.width // GRID_PX + 2
        rows = self.calibration.camera.height // GRID_PX + 2
        u, v = np.meshgrid(np.arange(columns) * float(GRID_PX), np.arange(rows) * float(GRID_PX))
        pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64, copy=False)
        mapped = self.calibration.table_from_image(pixels, self.height_mm)
        return PixelTable(np.ascontiguousarray(mapped.reshape(rows, columns, 2)), float(GRID_PX))

    @cached_property
    def forward(self) -> ForwardTable | None:
        """A table from the plane to pixels, or None where it would not be exact enough: a view along the table, say."""
        if self.usable is not None:
            return None
        seen = self.grid.mm.reshape(-1, 2)
        pitch = GRID_PX * self.mm_per_px
        with np.errstate(invalid="ignore", over="ignore"):
            low, high = seen.min(axis=0), seen.max(axis=0)
            low, high = low - BEYOND * (high - low), high + BEYOND * (high - low)
            steps: Points = np.ceil((high - low) / pitch) + 1
        if not (np.all(np.isfinite(steps)) and steps.min() >= MIN_STEPS and float(np.prod(steps)) <= MAX_SAMPLES):
            return None
        columns, rows = int(steps[0]), int(steps[1])
        indices = np.mgrid[0:rows, 0:columns][::-1].reshape(2, -1).T
        points = low + pitch * indices.astype(np.float64)
        top = self.to_pixels(points)
        foot = top if self.height_mm == 0.0 else self.calibration.image_from_table(points, 0.0)
        pixels = np.column_stack([top, foot]).reshape(rows, columns, 4)
        # Between the samples it must be right wherever slabs can be seen, and finite everywhere.
        inner = pixels[1:-2, 1:-2]
        u, v = inner[:, :, 0], inner[:, :, 1]
        camera = self.calibration.camera
        visible = np.argwhere((u > -GRID_PX) & (u < camera.width) & (v > -GRID_PX) & (v < camera.height)) + 1
        if not np.all(np.isfinite(pixels)) or len(visible) == 0:
            return None
        weights = np.array([-1.0, 9.0, 9.0, -1.0]) / 16.0  # cubic, half way between the middle two of four
        around = visible[:, None, :] + np.stack(np.meshgrid(range(-1, 3), range(-1, 3)), axis=-1).reshape(-1, 2)
        between = np.einsum("k,nkc->nc", np.outer(weights, weights).ravel(), pixels[around[:, :, 0], around[:, :, 1]])
        exact = self.to_pixels(low + pitch * (visible[:, ::-1] + 0.5))
        if float(np.abs(between[:, :2] - exact).max()) > FORWARD_PX:
            return None
        return ForwardTable(np.ascontiguousarray(pixels), float(low[0]), float(low[1]), pitch, self.height_mm == 0.0)

    @cached_property
    def usable(self) -> npt.NDArray[np.bool_] | None:
        """Where the picture sees the plane, in squares of GRID_PX from its corner on; None where it does everywhere.

        Beyond the horizon, and where a lens model folds over because no corner of a board was ever seen there, pixels
        are no places.  Raises CalibrationError if that is so in the middle of the picture.
        """
        grid = self.grid.mm
        rows, columns, _ = grid.shape
        corners = np.mgrid[0:rows, 0:columns][::-1].reshape(2, -1).T * float(GRID_PX)
        places = grid.reshape(-1, 2)
        with np.errstate(all="ignore"):
            far = np.abs(places) < FARTHEST_MM
            known = far[:, 0] & far[:, 1]
            seen = self.to_pixels(np.where(known[:, None], places, 0.0))
            known &= np.hypot(*(seen - corners).T) <= ROUND_TRIP_PX
            known &= self._in_front(places)
            right, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
            turn = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
            size = np.sqrt(np.abs(turn)) / GRID_PX
        known = known.reshape(rows, columns)
        cells = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
        cells &= (size >= SMALLEST_PX_MM) & (size <= LARGEST_PX_MM)
        camera = self.calibration.camera
        middle = (camera.height // 2 // GRID_PX, camera.width // 2 // GRID_PX)
        cells &= np.sign(turn) == np.sign(turn[middle])
        if not cells[middle]:
            raise CalibrationError(
                f"this calibration says that the middle of the picture sees no place of the table, or one whose pixels"
                f" are not between {SMALLEST_PX_MM:g} and {LARGEST_PX_MM:g} mm: calibrate again"
            )
        return None if cells.all() else cells

    def _in_front(self, places: Points) -> npt.NDArray[np.bool_]:
        """Return which places of the plane lie before the camera, not behind it."""
        plane = self.calibration.require_plane()
        flat = np.linalg.solve(plane.adjustment[:, :2], (places - plane.adjustment[:, 2]).T).T
        return flat @ plane.rotation[2, :2] + self.height_mm * plane.rotation[2, 2] + plane.translation[2] > 0.0

    @cached_property
    def mm_per_px(self) -> float:
        """Size of a pixel on the plane at the centre of the picture."""
        return float(np.sqrt(abs(self._centre_area)))

    @cached_property
    def mirrored(self) -> bool:
        """Whether counter-clockwise on the table is clockwise in pixel coordinates (u right, v down)."""
        return self._centre_area < 0

    @cached_property
    def _centre_area(self) -> float:
        centre = np.array([self.calibration.camera.width, self.calibration.camera.height]) / 2.0
        corner, right, down = self.calibration.table_from_image(
            centre + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), self.height_mm
        )
        first, second = right - corner, down - corner
        return float(first[0] * second[1] - first[1] * second[0])

    def from_pixels(self, pixels: Points) -> Points:
        """Return plane points in mm for pixels (n, 2), to about a twentieth of a pixel."""
        return self.grid.at(pixels)

    def to_pixels(self, points: Points) -> Points:
        """Return the pixels, shape (n, 2), at which points of the plane are seen; exact."""
        return self.calibration.image_from_table(points, self.height_mm)

    def foot_shift(self, points: Points) -> Points:
        """Return by how much the work plane below each point is seen beside it, as a shift on this plane in mm.

        The shift points to where the camera stands: on the sides that face it, the wall of a slab is visible over this
        length.
        """
        if self.height_mm == 0.0 or len(points) == 0:
            return np.zeros_like(points)
        return self.from_pixels(self.calibration.image_from_table(points, 0.0)) - self.from_pixels(
            self.to_pixels(points)
        )
