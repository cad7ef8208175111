"""What does an outline look like in numbers?  Features of blobs and of slots, in millimetres, made the same way.

The outline is sampled at equal arc lengths; everything that matching compares comes from those samples.
"""

from collections.abc import Sequence

from slabcell.geometry import Points, Polygon
from slabcell.vision.blobs import Blobs
from slabcell.vision.kernel import engine
from slabcell.vision.outline import Rings
from slabcell.vision.plane import PlaneView
from slabcell.vision.shapes import SAMPLES, Shapes

__all__ = ["describe_blobs", "describe_polygons", "describe_slots"]


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
        return engine().describe(engine().strip_walls(plane, Rings.of([blob.polygon for blob in blobs])))
    return engine().describe_pixels(plane.grid, blobs.points, blobs.begins, blobs.ends)
