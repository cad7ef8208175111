"""How do pixels and the upper faces of slabs correspond, quickly?  A calibration, sampled for one height.

Contours need a tenth of a pixel and are many points: they go through a table sampled from the calibration.  Edges that
are measured go through the calibration itself.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from slabcell.calibration.model import Calibration
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["GRID_PX", "PlaneView"]

# Distance of the samples in pixels; between them the mapping is bilinear, which is good to 0.05 px for usual lenses.
GRID_PX = 24
# Sizes of a pixel, and distances on the table, that a cell can have.
SMALLEST_PX_MM, LARGEST_PX_MM = 1e-3, 1e2
FARTHEST_MM = 1e6
# By how much a point of the table may be seen beside the pixel that it was taken from.
ROUND_TRIP_PX = 0.5


@dataclass(frozen=True, eq=False)
class PlaneView:
    """The plane z = ``height_mm`` as one camera sees it."""

    calibration: Calibration
    height_mm: float

    @cached_property
    def _grid(self) -> tuple[Points, int, int]:
        columns = self.calibration.camera.width // GRID_PX + 2
        rows = self.calibration.camera.height // GRID_PX + 2
        u, v = np.meshgrid(np.arange(columns) * float(GRID_PX), np.arange(rows) * float(GRID_PX))
        pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64, copy=False)
        mapped = self.calibration.table_from_image(pixels, self.height_mm)
        return mapped.reshape(rows, columns, 2), rows, columns

    @cached_property
    def usable(self) -> npt.NDArray[np.bool_] | None:
        """Where the picture sees the plane, in squares of GRID_PX from its corner on; None where it does everywhere.

        Beyond the horizon, and where a lens model folds over because no corner of a board was ever seen there, pixels
        are no places.  Raises CalibrationError if that is so in the middle of the picture.
        """
        grid, rows, columns = self._grid
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
        grid, rows, columns = self._grid
        cells = pixels / GRID_PX
        whole = np.floor(cells).astype(np.intp)
        column = np.clip(whole[:, 0], 0, columns - 2)
        row = np.clip(whole[:, 1], 0, rows - 2)
        right = (cells[:, 0] - column)[:, None]
        down = (cells[:, 1] - row)[:, None]
        upper = grid[row, column] * (1 - right) + grid[row, column + 1] * right
        lower = grid[row + 1, column] * (1 - right) + grid[row + 1, column + 1] * right
        return upper * (1 - down) + lower * down

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
