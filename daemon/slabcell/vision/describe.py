"""What does an outline look like in numbers?  Features of blobs and of slots, in millimetres, made the same way.

The outline is sampled at equal arc lengths; everything that matching compares comes from those samples.
"""

from collections.abc import Sequence

import numpy as np

from slabcell.geometry import Points, Polygon
from slabcell.vision.blobs import Blobs
from slabcell.vision.kernel import engine
from slabcell.vision.outline import Rings
from slabcell.vision.plane import PlaneView
from slabcell.vision.shapes import SAMPLES, Shapes

__all__ = ["MIN_WALL_PX", "describe_blobs", "describe_polygons", "describe_slots"]

# Samples of an outline from which the visible walls are taken away; finer, because corners shall stay.
WALL_SAMPLES = 512
# Visible walls narrower than this change a contour less than its own noise.
MIN_WALL_PX = 0.7


def describe_polygons(polygons: Sequence[Points]) -> Shapes:
    """Return the features of polygons (n, 2) in mm, whichever way they turn, with the normals of their samples."""
    rings = Rings.of(polygons).counter_clockwise()
    return engine().describe(rings).with_normals(rings.normals(SAMPLES))


def describe_slots(slots: Sequence[Polygon]) -> Shapes:
    """Return the features of a template's slots, in its own frame."""
    return describe_polygons([slot.vertices for slot in slots])


def describe_blobs(blobs: Blobs, plane: PlaneView, *, without_walls: bool) -> Shapes:
    """Return the features of blobs on the plane of the slabs' upper faces.

    ``without_walls``: take away from each outline the strip in which the wall of a slab of that height is seen.
    """
    if without_walls and blobs:
        # Which way an outline faces is plain from its simplified polygon alone.
        seen = Rings.of([blob.polygon for blob in blobs])
        rings = seen.moved(engine().to_plane(plane.grid, seen.points)).counter_clockwise()
        return engine().describe(_without_walls(rings, plane))
    return engine().describe_pixels(plane.grid, blobs.points, blobs.begins, blobs.ends)


def widest_wall_px(plane: PlaneView) -> float:
    """Return how wide the walls of slabs are seen at most, anywhere in the picture."""
    camera = plane.calibration.camera
    corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]], float)
    shift = plane.foot_shift(plane.from_pixels(corners))
    return float(np.max(np.hypot(shift[:, 0], shift[:, 1]))) / plane.mm_per_px


def _without_walls(rings: Rings, plane: PlaneView) -> Rings:
    """Return the outlines of the upper faces alone.

    The silhouette of a slab is its upper face swept along the shift of its foot: where the outline faces that way it
    has moved by the shift, elsewhere it is the upper face's own.
    """
    shift = plane.foot_shift(rings.moments[1])
    size = np.hypot(shift[:, 0], shift[:, 1])
    points = rings.resampled(WALL_SAMPLES)
    tangent = np.roll(points, -2, axis=1) - np.roll(points, 2, axis=1)
    length = np.maximum(np.hypot(tangent[:, :, 0], tangent[:, :, 1]), 1e-9)
    cross = tangent[:, :, 1] * shift[:, None, 0] - tangent[:, :, 0] * shift[:, None, 1]
    facing = np.clip(cross / (length * np.maximum(size, 1e-9)[:, None]) / 0.3, 0.0, 1.0)
    facing[size < MIN_WALL_PX * plane.mm_per_px] = 0.0
    stripped = points - facing[:, :, None] * shift[:, None, :]
    return Rings(stripped.reshape(-1, 2), np.arange(len(rings) + 1) * WALL_SAMPLES)
