"""Where in the picture are the edges of slabs expected?  Pieces of outlines, laid on the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.edge_profile import EdgeLines
from slabcell.vision.edges import EdgePieces
from slabcell.vision.local_map import LocalMaps, derivatives, evaluate, map_locally, monomials
from slabcell.vision.plane import PlaneView

__all__ = ["Poses", "ProjectedEdges", "maps_of", "project_edges", "project_through"]

Floats = npt.NDArray[np.float64]

# How far beyond an outline its map holds: the slab may lie that far from where it is expected.
MARGIN_PX = 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """How outlines are assumed to lie on the table; arrays over outlines.

    ``pivot`` (n, 2) is the middle of each outline in its own frame, ``position`` (n, 2) the same point on the table,
    ``rotation`` (n,) in radians, ``kerf`` (n,) mm by which the edges lie outside of the drawn ones.
    """

    rotation: Floats
    position: Points
    pivot: Points
    kerf: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedEdges:
    """Pieces of all outlines; arrays over pieces, those of one outline are neighbours.

    ``owner``: index of the outline.  ``lines``: the pieces in the picture.  ``outward`` (n, 2): normal on the table.
    ``rows`` (n, 4): how far the piece moves outward per mm of x and y, per radian about the outline's middle and per mm
    of kerf.  ``px_per_mm``: along the normal.  ``share``: of the outline's measurable length.  ``on_table`` (n, 2):
    middles of the pieces, mm.
    """

    owner: npt.NDArray[np.intp]
    lines: EdgeLines
    outward: Points
    rows: Floats
    px_per_mm: Floats
    share: Floats
    on_table: Points


def project_edges(plane: PlaneView, outlines: Sequence[EdgePieces], poses: Poses) -> ProjectedEdges:
    """Return the pieces of outlines as the camera sees them at these poses."""
    return project_through(maps_of(plane, outlines, poses), outlines, poses, mirrored=plane.mirrored)


def maps_of(plane: PlaneView, outlines: Sequence[EdgePieces], poses: Poses) -> LocalMaps:
    """Return maps that hold where the outlines lie, and a little around."""
    reach = [
        float(np.hypot(*(item.middle - pivot).T).max(initial=0.0)) + float(item.half_mm.max(initial=0.0))
        for item, pivot in zip(outlines, poses.pivot, strict=True)
    ]
    return map_locally(plane, poses.position, np.array(reach) + MARGIN_PX * plane.mm_per_px)


def project_through(maps: LocalMaps, outlines: Sequence[EdgePieces], poses: Poses, *, mirrored: bool) -> ProjectedEdges:
    """Return the pieces of outlines as they are seen through maps made for poses near these."""
    owner = np.repeat(np.arange(len(outlines)), [len(item) for item in outlines])
    middle = np.concatenate([item.middle for item in outlines])
    tangent = np.concatenate([item.tangent for item in outlines])
    half = np.concatenate([item.half_mm for item in outlines])
    bend = np.concatenate([item.bend for item in outlines])
    cos, sin = np.cos(poses.rotation[owner]), np.sin(poses.rotation[owner])
    arm = _turn(middle - poses.pivot[owner], cos, sin)
    along = _turn(tangent, cos, sin)
    outward = np.column_stack([along[:, 1], -along[:, 0]])
    # The outline that is expected is the drawn one, moved out by the kerf found so far.
    on_table = poses.position[owner] + arm + poses.kerf[owner][:, None] * outward
    size = maps.size[owner][:, None]
    place = (on_table - maps.centre[owner]) / size
    reach = (half[:, None] * along) / size
    bulge = ((bend * half**2)[:, None] * outward) / size
    top = maps.top[owner]
    centre = evaluate(top, monomials(place[:, 0], place[:, 1]))
    before, after = place - reach + bulge, place + reach + bulge
    start = evaluate(top, monomials(before[:, 0], before[:, 1]))
    stop = evaluate(top, monomials(after[:, 0], after[:, 1]))
    by_x, by_y = derivatives(place[:, 0], place[:, 1])
    outwards = (
        outward[:, :1] * evaluate(top, by_x) + outward[:, 1:] * evaluate(top, by_y)
    ) / size  # pixels per mm along the normal
    foot = evaluate(maps.foot[owner], monomials(place[:, 0], place[:, 1]))
    chord = stop - start
    length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-9)
    line = chord / length[:, None]
    # In a picture v points down: which side is outside follows from the handedness of the mapping.
    normal = np.column_stack([line[:, 1], -line[:, 0]]) * (-1.0 if mirrored else 1.0)
    sag = np.sum(normal * (0.5 * (start + stop) - centre), axis=1)
    wall = np.maximum(np.sum(normal * (foot - centre), axis=1), 0.0)
    turn = outward[:, 1] * arm[:, 0] - outward[:, 0] * arm[:, 1]
    return ProjectedEdges(
        owner,
        EdgeLines(centre, normal, 0.5 * length, sag / (0.25 * length**2), wall),
        outward,
        np.column_stack([outward, turn, np.ones(len(arm))]),
        np.sum(normal * outwards, axis=1),
        half / np.maximum(np.bincount(owner, half)[owner], 1e-9),
        on_table,
    )


def _turn(points: Points, cos: Floats, sin: Floats) -> Points:
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])
