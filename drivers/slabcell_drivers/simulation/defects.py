"""What can be wrong with slabs before anything is done with them?  Chipped, broken, or lying against each other."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import shapely
from shapely.affinity import translate

from slabcell_drivers.simulation.areas import Area
from slabcell_drivers.simulation.slab import Slab

__all__ = ["broken", "chipped", "touching"]

Points = npt.NDArray[np.float64]

# Corners nearer to each other than this are one.
SAME_MM = 1e-6


def chipped(slab: Slab, random: np.random.Generator, *, size_mm: float) -> Slab:
    """Return the slab with a corner broken off, up to ``size_mm`` along each side; its nominal shape stays.

    Raises ValueError if that would leave less than half of it.
    """
    corners = len(slab.body)
    angles = _corner_angles(slab.body)
    sharp = np.flatnonzero(angles < np.pi)
    index = int(random.choice(sharp))
    before, here, after = (slab.body[(index + step) % corners] for step in (-1, 0, 1))
    cut = [
        here + (end - here) * min(0.8, size_mm * float(random.uniform(0.7, 1.0)) / float(np.linalg.norm(end - here)))
        for end in (before, after)
    ]
    middle = (cut[0] + cut[1]) / 2
    jag = middle + (middle - here) * float(random.uniform(0.0, 0.3))
    beyond = here + (here - middle)  # off the slab, so that the cut does not run along its rim
    return _with_body(slab, shapely.Polygon(slab.body).difference(shapely.Polygon([cut[0], beyond, cut[1], jag])))


def broken(slab: Slab, random: np.random.Generator, *, share: float = 0.35) -> Slab:
    """Return what is left of the slab after ``share`` of its area broke off along a line; its nominal shape stays.

    Raises ValueError if that would leave less than half of it in one piece.
    """
    shape = shapely.Polygon(slab.body)
    angle = random.uniform(0, 2 * np.pi)
    normal = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-normal[1], normal[0]])
    far = 10.0 * float(np.ptp(slab.body, axis=0).max())
    heights = slab.body @ normal
    low, high = float(heights.min()), float(heights.max())
    rest: Area = shape
    for _ in range(50):
        offset = 0.5 * (low + high)
        start, end = normal * offset - along * far, normal * offset + along * far
        rest = shape.difference(shapely.Polygon([start, end, end + normal * far, start + normal * far]))
        low, high = (offset, high) if rest.area < (1.0 - share) * shape.area else (low, offset)
    return _with_body(slab, rest)


def touching(slabs: Sequence[Slab], mover: int, fixed: int, *, gap_mm: float = 0.0) -> tuple[Slab, ...]:
    """Return the slabs with one pushed straight towards another until so little is left between them.

    Raises ValueError if a third slab is in the way.
    """
    moving, target = slabs[mover].shape, slabs[fixed].shape
    start, goal = (np.asarray(shape.centroid.coords)[0] for shape in (moving, target))
    along = goal - start
    low, high = 0.0, 1.0
    for _ in range(60):  # the distance shrinks until the outlines meet, which lies before the centroids do
        middle = 0.5 * (low + high)
        near = translate(moving, *(along * middle)).distance(target)
        low, high = (middle, high) if near > gap_mm else (low, middle)
    pushed = translate(moving, *(along * low))
    for slab in slabs:
        if slab.number not in (mover, fixed) and slab.shape.intersects(pushed):
            msg = f"slab {slab.number} lies between slabs {mover} and {fixed}: they cannot be pushed together"
            raise ValueError(msg)
    frame = slabs[mover].frame
    moved = replace(frame, x_mm=frame.x_mm + float(along[0]) * low, y_mm=frame.y_mm + float(along[1]) * low)
    return tuple(replace(slab, frame=moved) if slab.number == mover else slab for slab in slabs)


def _with_body(slab: Slab, rest: Area) -> Slab:
    parts = [part for part in shapely.get_parts(rest) if isinstance(part, shapely.Polygon)]
    largest = max(parts, key=lambda part: part.area)
    if largest.area < 0.5 * shapely.Polygon(slab.body).area:
        msg = f"slab {slab.number} would lose more than half of its area"
        raise ValueError(msg)
    body = np.asarray(shapely.orient_polygons(largest).exterior.coords)[:-1]
    # Two corners in one place cross each other once a rotation has rounded them.
    body = body[np.hypot(*(body - np.roll(body, 1, axis=0)).T) > SAME_MM]
    nominal = slab.nominal if len(slab.nominal) else slab.body
    return replace(slab, body=body, nominal=nominal)


def _corner_angles(body: Points) -> npt.NDArray[np.float64]:
    """Return the inner angle at each corner of a counter-clockwise outline."""
    before, after = np.roll(body, 1, axis=0) - body, np.roll(body, -1, axis=0) - body
    turn = np.arctan2(before[:, 1], before[:, 0]) - np.arctan2(after[:, 1], after[:, 0])
    return np.asarray(turn % (2 * np.pi), np.float64)
