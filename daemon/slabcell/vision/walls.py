"""How much of a slab's outline is its wall?  A camera beside a slab sees its side too, which is no part of its face.

This holds the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

import numpy as np

from slabcell.vision.outline import Rings
from slabcell.vision.plane import PlaneView

__all__ = ["FACING", "MIN_WALL_PX", "WALL_SAMPLES", "strip_walls", "widest_wall_px"]

# Samples of an outline from which the visible walls are taken away; finer, because corners shall stay.
WALL_SAMPLES = 512
# Visible walls narrower than this change a contour less than its own noise.
MIN_WALL_PX = 0.7
# Where the sine between outline and shift is larger than this, the whole wall is seen.
FACING = 0.3


def widest_wall_px(plane: PlaneView) -> float:
    """Return how wide the walls of slabs are seen at most, anywhere in the picture."""
    camera = plane.calibration.camera
    corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]], float)
    shift = plane.foot_shift(plane.from_pixels(corners))
    return float(np.max(np.hypot(shift[:, 0], shift[:, 1]))) / plane.mm_per_px


def strip_walls(plane: PlaneView, seen: Rings) -> Rings:
    """Return the outlines of upper faces, in mm and counter-clockwise, of slabs that are seen in outlines in pixels.

    The silhouette of a slab is its upper face swept along the shift of its foot: where the outline faces that way it
    has moved by the shift, elsewhere it is the upper face's own.  Every ring gets WALL_SAMPLES points.
    """
    rings = seen.moved(plane.from_pixels(seen.points)).counter_clockwise()
    shift = plane.foot_shift(rings.moments[1])
    size = np.hypot(shift[:, 0], shift[:, 1])
    points = rings.resampled(WALL_SAMPLES)
    tangent = np.roll(points, -2, axis=1) - np.roll(points, 2, axis=1)
    length = np.maximum(np.hypot(tangent[:, :, 0], tangent[:, :, 1]), 1e-9)
    cross = tangent[:, :, 1] * shift[:, None, 0] - tangent[:, :, 0] * shift[:, None, 1]
    facing = np.clip(cross / (length * np.maximum(size, 1e-9)[:, None]) / FACING, 0.0, 1.0)
    facing[size < MIN_WALL_PX * plane.mm_per_px] = 0.0
    stripped = points - facing[:, :, None] * shift[:, None, :]
    return Rings(stripped.reshape(-1, 2), np.arange(len(rings) + 1) * WALL_SAMPLES)
