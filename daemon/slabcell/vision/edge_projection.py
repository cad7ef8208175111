"""Where in the picture are the edges of slabs expected?  Pieces of outlines, laid on the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.edge_profile import EdgeLines
from slabcell.vision.edges import EdgePieces
from slabcell.vision.plane import PlaneView

__all__ = ["Poses", "ProjectedEdges", "project_edges"]

Floats = npt.NDArray[np.float64]


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
    step = plane.mm_per_px
    bulge = (bend * half**2)[:, None] * outward
    probes = np.concatenate(
        [
            on_table,
            on_table - half[:, None] * along + bulge,
            on_table + half[:, None] * along + bulge,
            on_table + step * outward,
        ]
    )
    centre, start, stop, beside = plane.to_pixels(probes).reshape(4, -1, 2)
    foot = plane.calibration.image_from_table(on_table, 0.0) if plane.height_mm else centre
    chord = stop - start
    length = np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-9)
    line = chord / length[:, None]
    # In a picture v points down: which side is outside follows from the handedness of the mapping.
    normal = np.column_stack([line[:, 1], -line[:, 0]]) * (-1.0 if plane.mirrored else 1.0)
    sag = np.sum(normal * (0.5 * (start + stop) - centre), axis=1)
    wall = np.maximum(np.sum(normal * (foot - centre), axis=1), 0.0)
    turn = outward[:, 1] * arm[:, 0] - outward[:, 0] * arm[:, 1]
    return ProjectedEdges(
        owner,
        EdgeLines(centre, normal, 0.5 * length, sag / (0.25 * length**2), wall),
        outward,
        np.column_stack([outward, turn, np.ones(len(arm))]),
        np.sum(normal * (beside - centre), axis=1) / step,
        half / np.maximum(np.bincount(owner, half)[owner], 1e-9),
        on_table,
    )


def _turn(points: Points, cos: Floats, sin: Floats) -> Points:
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])
