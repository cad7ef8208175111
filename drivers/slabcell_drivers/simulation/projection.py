"""Where in the picture is a point of the cell?  The simulated lens: perspective and Brown's distortion.

Source of the model: D. C. Brown, "Close-range camera calibration", 1971, with OpenCV's order of coefficients.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.simulation.scene import CameraSpec

__all__ = ["Projector", "rings"]

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Projector:
    """Takes points of the root frame (mm) to pixels.  ``scale`` above 1 gives the pixels of a finer grid."""

    camera: CameraSpec
    scale: int = 1

    @cached_property
    def matrix(self) -> Points:
        """Intrinsics of the grid, shape (3, 3)."""
        camera, scale = self.camera, self.scale
        shift = 0.5 * scale - 0.5  # the centre of the top-left pixel stays at 0, 0 of its own grid
        return np.array(
            [
                [camera.fx_px * scale, 0.0, camera.cx_px * scale + shift],
                [0.0, camera.fy_px * scale, camera.cy_px * scale + shift],
                [0.0, 0.0, 1.0],
            ]
        )

    @cached_property
    def _motion(self) -> tuple[Points, Points]:
        root_to_camera = np.linalg.inv(self.camera.frame.matrix)
        turn, _ = cv2.Rodrigues(root_to_camera[:3, :3])
        return np.asarray(turn, np.float64), np.asarray(root_to_camera[:3, 3], np.float64)

    @property
    def centre(self) -> Points:
        """The camera's centre in the root frame, shape (3,)."""
        return self.camera.frame.matrix[:3, 3]

    def pixels(self, points: Points) -> Points:
        """Return the pixels, shape (n, 2), of points in the root frame, shape (n, 3)."""
        turn, shift = self._motion
        found, _ = cv2.projectPoints(
            np.ascontiguousarray(points, np.float64).reshape(-1, 1, 3),
            turn,
            shift,
            self.matrix,
            np.array(self.camera.distortion),
        )
        return np.asarray(found, np.float64).reshape(-1, 2)

    def contour(self, ring: Points, plane: Points, step_px: float = 4.0) -> Points:
        """Return the pixels of a closed ring of plane points (n, 2); its edges are bent as the lens bends them.

        ``plane`` is the (4, 4) matrix that takes the plane's x, y, 0 to the root frame.  Edges are cut so finely that
        the chord keeps within some 1e-4 px of the curve for the distortion of usual lenses.
        """
        corners = self.pixels(_lift(ring, plane))
        length = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        pieces = np.clip(np.ceil(length / (step_px * self.scale)), 1, 20_000).astype(np.int64)
        edge = np.repeat(np.arange(len(ring)), pieces)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[edge]
        dense = ring[edge] + (np.roll(ring, -1, axis=0) - ring)[edge] * share[:, None]
        return self.pixels(_lift(dense, plane))


def _lift(points: Points, plane: Points) -> Points:
    return points @ plane[:3, :2].T + plane[:3, 3]


def rings(shape: shapely.Geometry) -> list[Points]:
    """Return the rings of an area, each shape (n, 2): outlines counter-clockwise, holes clockwise."""
    found: list[Points] = []
    for part in shapely.get_parts(shape):
        if isinstance(part, shapely.Polygon) and part.area > 0:
            turned = shapely.orient_polygons(part)
            found += [np.asarray(ring.coords)[:-1, :2] for ring in (turned.exterior, *turned.interiors)]
    return found
