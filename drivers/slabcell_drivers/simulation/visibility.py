"""Which faces of the slabs does the camera see, and where do they lie in its view?

Everything is projected from the camera's centre onto the root's plane z = 0, where straight edges stay straight.  Faces
are claimed from front to back; what is claimed hides the rest.  The result is a set of disjoint areas, so that their
pixel coverages may simply be added: a pixel that two faces share gets its exact mixture.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import shapely

from slabcell_drivers.simulation.areas import Area, common, minus, pairs_within, union
from slabcell_drivers.simulation.slab import Slab

__all__ = ["Face", "cast_shadows", "footprints", "seams", "visible_faces"]

Points = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A visible part of a slab, as an area of the plane z = 0 seen from the camera's centre.

    ``facing`` is the outward direction of a side wall, a unit vector in the root frame, and None for an upper face.
    """

    slab: Slab
    area: Area
    facing: tuple[float, float] | None = None


def visible_faces(slabs: Sequence[Slab], centre: Points) -> list[Face]:
    """Return what a camera at ``centre`` (root frame, shape (3,)) sees of the slabs, as disjoint areas."""
    outlines = [_counter_clockwise(slab.outline) for slab in slabs]
    levels = sorted({level for slab in slabs for level in (slab.top_mm, slab.bottom_mm)}, reverse=True)
    faces: list[Face] = []
    taken: Area = shapely.Polygon()
    for upper, lower in zip(levels, [*levels[1:], levels[-1] if levels else 0.0], strict=True):
        tops: list[Area] = []
        for slab, outline in zip(slabs, outlines, strict=True):
            if slab.top_mm == upper:
                area = shapely.Polygon(_on_ground(outline, upper, centre))
                tops.append(area)
                faces.append(Face(slab, minus(area, taken, *tops[:-1])))
        taken = union([taken, *tops])
        if lower < upper:
            band = _walls(slabs, outlines, upper, lower, centre)
            for slab, facing, quad in band:
                seen = minus(quad, taken)
                if seen.area > 0:
                    faces.append(Face(slab, seen, facing))
                taken = union([taken, quad])
    return [face for face in faces if face.area.area > 0]


def _walls(
    slabs: Sequence[Slab], outlines: list[Points], upper: float, lower: float, centre: Points
) -> list[tuple[Slab, tuple[float, float], shapely.Polygon]]:
    """Return the wall pieces between two heights that face the camera, nearest to its foot first."""
    found: list[tuple[float, Slab, tuple[float, float], shapely.Polygon]] = []
    for slab, outline in zip(slabs, outlines, strict=True):
        if not (slab.bottom_mm <= lower and slab.top_mm >= upper):
            continue
        along = np.roll(outline, -1, axis=0) - outline
        outward = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
        towards = np.sum(outward * (centre[:2] - outline), axis=1)
        top, foot = _on_ground(outline, upper, centre), _on_ground(outline, lower, centre)
        for index in np.flatnonzero(towards > 0):
            after = (index + 1) % len(outline)
            quad = shapely.Polygon([foot[index], foot[after], top[after], top[index]])
            if not quad.is_valid or quad.area <= 0:
                continue
            distance = quad.distance(shapely.Point(centre[:2]))
            found.append((distance, slab, (float(outward[index, 0]), float(outward[index, 1])), quad))
    found.sort(key=lambda item: item[0])
    return [item[1:] for item in found]


def _on_ground(points: Points, height: float, centre: Points) -> Points:
    """Return where the rays through points at ``height`` meet z = 0."""
    if height >= centre[2]:
        msg = f"a slab at {height:.1f} mm is not below the camera at {centre[2]:.1f} mm"
        raise ValueError(msg)
    return centre[:2] + (points - centre[:2]) * (centre[2] / (centre[2] - height))


def _counter_clockwise(points: Points) -> Points:
    x, y = points.T
    return points if np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) > 0 else points[::-1]


def footprints(slabs: Sequence[Slab], near_mm: float = 1.0) -> Area:
    """Return the area of the table on which slabs stand: those whose lower face is within ``near_mm`` of it."""
    return union(slab.shape for slab in slabs if slab.bottom_mm <= near_mm)


def cast_shadows(slabs: Sequence[Slab], away: tuple[float, float]) -> Area:
    """Return the area of the table in the shadow of slabs, ``away`` being its offset in mm per mm height."""
    parts: list[Area] = []
    shift = np.array(away)
    for slab in slabs:
        foot = slab.outline + shift * max(slab.bottom_mm, 0.0)
        top = slab.outline + shift * max(slab.top_mm, 0.0)
        parts += [shapely.Polygon(foot), shapely.Polygon(top)]
        for index in range(len(foot)):
            after = (index + 1) % len(foot)
            quad = shapely.MultiPoint([foot[index], foot[after], top[after], top[index]]).convex_hull
            parts.append(quad)
    return union(parts)


def seams(slabs: Sequence[Slab], width_mm: float) -> list[tuple[Area, float]]:
    """Return the joints between slabs of one height that touch: areas in the root frame, and their height."""
    found: list[tuple[Area, float]] = []
    shapes = [slab.shape for slab in slabs]
    for one, other in pairs_within(shapes, 0.5 * width_mm):
        if abs(slabs[one].top_mm - slabs[other].top_mm) < 0.5:
            rim, next_rim = (shapes[index].exterior.buffer(0.5 * width_mm) for index in (one, other))
            found.append((common(rim, next_rim), max(slabs[one].top_mm, slabs[other].top_mm)))
    return found
