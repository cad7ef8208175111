"""Where in the picture are the edges of slabs expected?  Pieces of outlines, laid on the table.

This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.edge_profile import EdgeLines
from slabcell.vision.edges import EdgePieces
from slabcell.vision.local_map import LocalMaps, derivatives, evaluate, monomials

__all__ = ["Outlines", "Poses", "ProjectedEdges", "project"]

Floats = npt.NDArray[np.float64]

# A wall narrower than this is not there: top and foot differ by rounding.
LEAST_WALL_PX = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Outlines:
    """Several outlines: ``pieces`` (n, 6) as in EdgePieces.table; ``starts`` (outlines + 1,) where each begins."""

    pieces: Floats
    starts: npt.NDArray[np.int64]

    @classmethod
    def of(cls, outlines: Sequence[EdgePieces]) -> "Outlines":
        """Return these outlines together."""
        starts = np.zeros(len(outlines) + 1, np.int64)
        np.cumsum([len(item) for item in outlines], out=starts[1:])
        return cls(np.concatenate([item.table for item in outlines]), starts)

    def __len__(self) -> int:
        return len(self.starts) - 1

    @property
    def owner(self) -> npt.NDArray[np.intp]:
        """Index of the outline of each piece."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))


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

    def selected(self, which: npt.NDArray[np.intp]) -> "Poses":
        """Return the poses of these outlines."""
        return Poses(self.rotation[which], self.position[which], self.pivot[which], self.kerf[which])

    def replaced(self, which: npt.NDArray[np.intp], others: "Poses") -> "Poses":
        """Return all poses, with ``others`` in the place of these."""
        rotation, position, kerf = self.rotation.copy(), self.position.copy(), self.kerf.copy()
        rotation[which], position[which], kerf[which] = others.rotation, others.position, others.kerf
        return Poses(rotation, position, self.pivot, kerf)


@dataclass(frozen=True, slots=True, eq=False)
class ProjectedEdges:
    """Pieces of all outlines as they are seen; arrays over pieces.

    ``lines``: in the picture.  ``extras`` (n, 8): the columns that the properties name.
    """

    lines: EdgeLines
    extras: Floats

    @property
    def rows(self) -> Floats:
        """How far the piece moves outward per mm of x, of y, per radian about the outline's middle, per mm of kerf."""
        return self.extras[:, 0:4]

    @property
    def outward(self) -> Points:
        """Normal on the table, (n, 2)."""
        return self.extras[:, 0:2]

    @property
    def px_per_mm(self) -> Floats:
        """Scale of the picture along the normal."""
        return self.extras[:, 4]

    @property
    def share(self) -> Floats:
        """Length over the measurable length of the outline."""
        return self.extras[:, 5]

    @property
    def on_table(self) -> Points:
        """Middle of the piece, mm, (n, 2)."""
        return self.extras[:, 6:8]


def project(outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
    """Return the pieces as they are seen through maps made for poses near these.

    ``mirrored``: counter-clockwise on the table is clockwise in pixel coordinates.
    """
    owner = outlines.owner
    middle, tangent = outlines.pieces[:, 0:2], outlines.pieces[:, 2:4]
    half, bend = outlines.pieces[:, 4], outlines.pieces[:, 5]
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
    wall = np.sum(normal * (foot - centre), axis=1)
    wall = np.where(wall > LEAST_WALL_PX, wall, 0.0)
    turn = outward[:, 1] * arm[:, 0] - outward[:, 0] * arm[:, 1]
    per_mm = np.sum(normal * outwards, axis=1)
    share = half / np.maximum(np.bincount(owner, half, minlength=len(outlines))[owner], 1e-9)
    return ProjectedEdges(
        EdgeLines.of(centre, normal, 0.5 * length, sag / (0.25 * length**2), wall),
        np.column_stack([outward, turn, np.ones(len(arm)), per_mm, share, on_table]),
    )


def _turn(points: Points, cos: Floats, sin: Floats) -> Points:
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])
