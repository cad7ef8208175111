"""Where on a slot's outline can its edge be measured?  Short pieces between the corners, straight or gently curved."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points, Polygon

__all__ = ["EdgePieces", "cut_edges"]

# A vertex that turns by more than this is a corner: pieces end before it.
CORNER_DEG = 15.0
# Distance kept from a corner, where blur mixes both edges.
CORNER_MARGIN_PX = 2.2
PIECE_PX = 24.0
MIN_PIECE_PX = 5.0
# Pieces of curved outlines are shorter, so that a parabola fits them.
MAX_TURN_DEG = 35.0
# Points of the outline through which a piece's parabola is laid.
FIT_POINTS = 9
# Bound on the pieces of one outline: longer outlines get longer pieces.
MAX_PIECES = 160
FEW_PIECES = 16
PROBE_PIECES = 5


@dataclass(frozen=True, eq=False)
class EdgePieces:
    """Pieces of an outline, all arrays over pieces, in the frame of the template (mm).

    ``middle`` (n, 2) lies on the outline; ``tangent`` (n, 2) counter-clockwise, so that outward is to its right;
    ``half_mm`` (n,) half the length; ``bend`` (n,) 1/mm: the outline is at middle + t·tangent + bend·t²·outward.
    """

    middle: Points
    tangent: Points
    half_mm: npt.NDArray[np.float64]
    bend: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.middle)

    @cached_property
    def table(self) -> Points:
        """The columns middle, tangent, half_mm and bend beside each other, (n, 6)."""
        return np.ascontiguousarray(np.column_stack([self.middle, self.tangent, self.half_mm, self.bend]))

    @cached_property
    def mean(self) -> tuple[float, float]:
        """The mean of the middles."""
        x, y = self.middle.mean(axis=0).tolist()
        return x, y

    @cached_property
    def reach_mm(self) -> float:
        """How far a piece is from the mean of all, at most."""
        if len(self) == 0:
            return 0.0
        away = self.middle - self.mean
        return float(np.hypot(away[:, 0], away[:, 1]).max() + self.half_mm.max())

    @cached_property
    def few(self) -> "EdgePieces":
        """Some of the pieces, spread over the outline: enough to find it when it is some pixels off."""
        return self.selected(np.arange(0, len(self), max(1, len(self) // FEW_PIECES)))

    @cached_property
    def probes(self) -> "EdgePieces":
        """A few of the pieces, from which the picture's blur and grain are measured."""
        return self.selected(np.arange(0, len(self), max(1, len(self) // PROBE_PIECES)))

    def selected(self, which: npt.NDArray[np.intp]) -> "EdgePieces":
        """Return these of the pieces."""
        return EdgePieces(self.middle[which], self.tangent[which], self.half_mm[which], self.bend[which])

    @property
    def outward(self) -> Points:
        """Unit normals that point out of the slab, shape (n, 2)."""
        return np.column_stack([self.tangent[:, 1], -self.tangent[:, 0]])


def cut_edges(slot: Polygon, mm_per_px: float) -> EdgePieces:
    """Return the measurable pieces of a slot's outline for pictures of about this scale."""
    vertices = slot.vertices
    before = vertices - np.roll(vertices, 1, axis=0)
    after = np.roll(vertices, -1, axis=0) - vertices
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turn = np.abs(np.rad2deg(np.arctan2(cross, np.sum(before * after, axis=1))))
    corners = np.flatnonzero(turn > CORNER_DEG)
    closed = len(corners) == 0
    first = 0 if closed else int(corners[0])
    ring, bends = np.roll(vertices, -first, axis=0), np.roll(turn, -first)
    ring = np.vstack([ring, ring[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    stops = [0.0, along[-1]] if closed else [*(along[(corners - first)]), along[-1]]
    margin = 0.0 if closed else CORNER_MARGIN_PX * mm_per_px
    target = max(PIECE_PX * mm_per_px, along[-1] / MAX_PIECES)
    starts: list[float] = []
    ends: list[float] = []
    for begin, end in pairwise(stops):
        free = end - begin - 2.0 * margin
        if free < MIN_PIECE_PX * mm_per_px:
            continue
        within = (along[:-1] > begin) & (along[:-1] < end) if not closed else np.ones(len(bends), np.bool_)
        count = max(1, round(free / target), int(np.ceil(float(bends[within].sum()) / MAX_TURN_DEG)))
        count = min(count, max(1, int(free / (MIN_PIECE_PX * mm_per_px))))
        borders = begin + margin + free * np.arange(count + 1) / count
        starts += [float(value) for value in borders[:-1]]
        ends += [float(value) for value in borders[1:]]
    return _fit(ring, along, np.array(starts), np.array(ends))


def _fit(
    ring: Points, along: npt.NDArray[np.float64], starts: npt.NDArray[np.float64], ends: npt.NDArray[np.float64]
) -> EdgePieces:
    """Lay a parabola through points of the outline between each start and end, given as arc lengths."""
    if len(starts) == 0:
        return EdgePieces(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    share = np.linspace(0.0, 1.0, FIT_POINTS)
    at = starts[:, None] + (ends - starts)[:, None] * share
    points = np.stack([np.interp(at, along, ring[:, 0]), np.interp(at, along, ring[:, 1])], axis=-1)
    chord = points[:, -1] - points[:, 0]
    length = np.hypot(chord[:, 0], chord[:, 1])
    tangent = chord / length[:, None]
    outward = np.column_stack([tangent[:, 1], -tangent[:, 0]])
    centre = 0.5 * (points[:, 0] + points[:, -1])
    relative = points - centre[:, None]
    position = np.einsum("nkd,nd->nk", relative, tangent)
    height = np.einsum("nkd,nd->nk", relative, outward)
    half = 0.5 * length
    scaled = position / half[:, None]
    # Least squares height = a + b·t + c·t² over points that are nearly even in t; b turns the tangent a little.
    design = np.stack([np.ones_like(scaled), scaled, scaled**2], axis=-1)
    normal: Points = np.einsum("nki,nkj->nij", design, design)
    right: Points = np.einsum("nki,nk->ni", design, height)
    fitted: Points = np.linalg.solve(normal, right[..., None])[..., 0].astype(np.float64, copy=False)
    turned = tangent + (fitted[:, 1] / half)[:, None] * outward
    turned /= np.hypot(turned[:, 0], turned[:, 1])[:, None]
    return EdgePieces(centre + fitted[:, :1] * outward, turned, half, fitted[:, 2] / half**2)
