"""What does an outline look like in numbers?  Features of blobs and of slots, in millimetres, made the same way.

The outline is sampled at equal arc lengths; everything that matching compares comes from those samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points, Polygon
from slabcell.vision.blobs import RawBlob
from slabcell.vision.outline import Rings
from slabcell.vision.plane import PlaneView

__all__ = ["MIN_WALL_PX", "SAMPLES", "Shapes", "describe_blobs", "describe_polygons"]

SAMPLES = 128
# Samples of an outline from which the visible walls are taken away; finer, because corners shall stay.
WALL_SAMPLES = 512
# Visible walls narrower than this change a contour less than its own noise.
MIN_WALL_PX = 0.7


@dataclass(frozen=True, eq=False)
class Shapes:
    """Several outlines in one frame.

    ``samples`` (n, SAMPLES) complex, x + iy in mm, counter-clockwise, minus ``middle``; ``middle`` (n,) complex mean of
    the samples; ``area_mm2``, ``inertia`` (n,): area, and polar second moment over area squared; ``centroid`` (n, 2).
    """

    samples: npt.NDArray[np.complex128]
    middle: npt.NDArray[np.complex128]
    area_mm2: npt.NDArray[np.float64]
    inertia: npt.NDArray[np.float64]
    centroid: Points

    def __len__(self) -> int:
        return len(self.middle)


def describe_rings(rings: Rings) -> Shapes:
    """Return the features of polygons in mm, whichever way they turn."""
    rings = rings.counter_clockwise()
    area, centroid, inertia = rings.moments
    points = rings.resampled(SAMPLES)
    samples = points[:, :, 0] + 1j * points[:, :, 1]
    middle = samples.mean(axis=1)
    return Shapes(samples - middle[:, None], middle, np.abs(area), inertia, centroid)


def describe_polygons(polygons: Sequence[Points]) -> Shapes:
    """Return the features of polygons (n, 2) in mm."""
    return describe_rings(Rings.of(polygons))


def describe_slots(slots: Sequence[Polygon]) -> Shapes:
    """Return the features of a template's slots, in its own frame."""
    return describe_polygons([slot.vertices for slot in slots])


def describe_blobs(blobs: Sequence[RawBlob], plane: PlaneView, *, without_walls: bool) -> Shapes:
    """Return the features of blobs on the plane of the slabs' upper faces.

    ``without_walls``: take away from each outline the strip in which the wall of a slab of that height is seen.
    """
    seen = Rings.of([blob.polygon for blob in blobs])
    rings = seen.moved(plane.from_pixels(seen.points)).counter_clockwise()
    # Half a pixel: the outline runs through the centres of the blob's own pixels, its edge is outside of them.
    rings = rings.offset_outward(0.5 * plane.mm_per_px)
    return describe_rings(_without_walls(rings, plane) if without_walls else rings)


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
