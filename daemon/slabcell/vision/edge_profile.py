"""Where does the edge run, beside where it was expected?  One shift per piece of edge, from the raw pixels.

Every pixel near a piece is sorted by its exact distance from the expected edge into narrow bins; the grey level over
that distance is the edge's profile.  A model is fitted to it: grey inside and outside, each with a slope (light and
contact shadows change slowly), a step blurred by a Gaussian point spread, and where the wall of a thick slab is visible
between both a strip of known width and nearly known grey.  The position of the step is what is asked; nothing is
interpolated.

This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from slabcell.geometry import Points
from slabcell.vision.pixels import Grey

Floats = npt.NDArray[np.float64]

__all__ = ["EdgeLines", "EdgeShifts", "ProfileModel", "measure_edges"]

BINS_PER_PX = 4
# Columns of the model: grey inside, outside, of the wall, step, slope inside, slope outside.
COLUMNS = 6
STEP = 3
ITERATIONS = 5
# After a step smaller than this the next one would be smaller than 1e-3 px.
CONVERGED_PX = 0.08
# A wall wider than this is a second edge far enough away: the profile ends before it.
WIDE_WALL_PX = 14.0
SQRT_2_PI = float(np.sqrt(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLines:
    """Pieces of edge in a picture, in pixels: ``table`` (n, 7) holds the columns that the properties name."""

    table: Floats

    @classmethod
    def of(cls, middle: Points, outward: Points, half: Floats, bend: Floats, wall: Floats) -> Self:
        """Return lines of these columns."""
        return cls(np.ascontiguousarray(np.column_stack([middle, outward, half, bend, wall]), np.float64))

    def __len__(self) -> int:
        return len(self.table)

    def select(self, which: npt.NDArray[np.intp]) -> Self:
        """Return only these pieces."""
        return type(self)(self.table[which])

    @property
    def middle(self) -> Points:
        """Point on the edge, (n, 2)."""
        return self.table[:, 0:2]

    @property
    def outward(self) -> Points:
        """Unit normal out of the slab, (n, 2)."""
        return self.table[:, 2:4]

    @property
    def half(self) -> Floats:
        """Half the length, (n,)."""
        return self.table[:, 4]

    @property
    def bend(self) -> Floats:
        """The edge is at middle + t·tangent + bend·t²·outward, (n,)."""
        return self.table[:, 5]

    @property
    def wall(self) -> Floats:
        """Width of the visible wall outside of the edge, (n,)."""
        return self.table[:, 6]


@dataclass(frozen=True, slots=True)
class ProfileModel:
    """What is known about every edge of a picture.

    ``sigma_px``: of the point spread, pixel area included.  ``reach_px``: how far from the edge pixels are used.
    ``wall_ratio``: grey of a wall over grey of the upper face, and ``wall_ratio_sigma`` how well that is known.
    ``near``: the edges are within a fraction of a pixel of where they are expected.
    """

    sigma_px: float
    reach_px: float
    wall_ratio: float
    wall_ratio_sigma: float
    near: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class EdgeShifts:
    """Result of a measurement; arrays over pieces.

    ``shift`` px outward; ``sigma`` px, its standard deviation from the scatter about the model; ``inside``,
    ``outside``, ``wall``: grey levels at the edge; ``valid``: whether there is an edge that the model describes;
    ``scatter``: variance of the bins' grey about the model, each counted as often as it holds pixels.
    """

    shift: Floats
    sigma: Floats
    inside: Floats
    outside: Floats
    wall: Floats
    valid: npt.NDArray[np.bool_]
    scatter: Floats


def measure_edges(grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
    """Return how far outward of its expected place each piece of edge lies."""
    count, depth, level = collect_profiles(grey, lines, model)
    return fit_profiles(count, depth, level, lines.wall, model)


def outer_reach(wall: Floats, reach: float) -> Floats:
    """Return how far outside of each edge pixels are used: past the wall's foot, or short of it when it is wide."""
    return np.where(wall > WIDE_WALL_PX, WIDE_WALL_PX - 2.0, wall + reach)


def collect_profiles(grey: Grey, lines: EdgeLines, model: ProfileModel) -> tuple[Floats, Floats, Floats]:
    """Return for each piece and bin the number of pixels, their mean depth (px, inside positive) and mean grey."""
    height, width = grey.shape
    outer = outer_reach(lines.wall, model.reach_px)
    # A whole number of pixels, so that the bins are the same however many pieces are measured together.
    deepest = float(np.ceil(outer.max())) if len(lines) else 0.0
    bins = int(np.ceil((deepest + model.reach_px) * BINS_PER_PX)) + 1
    tangent = np.column_stack([-lines.outward[:, 1], lines.outward[:, 0]])
    # Scan along the axis that the edge follows more closely, so that every pixel of the strip is met once.
    along_u = np.abs(tangent[:, 0]) >= np.abs(tangent[:, 1])
    major = np.where(along_u, 0, 1)
    rows = np.arange(len(lines))
    t_major = tangent[rows, major]
    t_minor = tangent[rows, 1 - major]
    mid_major = lines.middle[rows, major]
    mid_minor = lines.middle[rows, 1 - major]
    n_minor = lines.outward[rows, 1 - major]
    strip = model.reach_px + deepest
    span = int(np.ceil(2.0 * float(np.max(lines.half, initial=0.0)) + 2 * strip)) + 2
    tall = int(np.ceil(strip * 1.4143)) + 3
    first_major = np.ceil(mid_major - 0.5 * span)
    a = first_major[:, None] + np.arange(span)
    # Middle of the strip on each scan line.
    centre = mid_minor[:, None] + (a - mid_major[:, None]) * (t_minor / t_major)[:, None]
    centre += (0.5 * (outer - model.reach_px) / n_minor)[:, None]
    b = np.ceil(centre - 0.5 * tall)[:, :, None] + np.arange(tall)
    da = (a - mid_major[:, None])[:, :, None]
    db = b - mid_minor[:, None, None]
    t = da * t_major[:, None, None] + db * t_minor[:, None, None]
    n_major = lines.outward[rows, major]
    depth = lines.bend[:, None, None] * t * t - da * n_major[:, None, None] - db * n_minor[:, None, None]
    a_full = np.broadcast_to(a[:, :, None], b.shape)
    u = np.where(along_u[:, None, None], a_full, b)
    v = np.where(along_u[:, None, None], b, a_full)
    use = (np.abs(t) <= lines.half[:, None, None]) & (depth < model.reach_px) & (depth >= -outer[:, None, None])
    use &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    piece, _, _ = np.nonzero(use)
    selected = depth[use]
    values = grey[v[use].astype(np.intp), u[use].astype(np.intp)].astype(np.float64)
    slot = piece * bins + np.floor((selected + deepest) * BINS_PER_PX).astype(np.intp)
    total = len(lines) * bins
    count = np.bincount(slot, minlength=total).astype(np.float64)
    filled = np.maximum(count, 1.0)
    mean_depth = np.bincount(slot, selected, minlength=total) / filled
    mean_level = np.bincount(slot, values, minlength=total) / filled
    shape = (len(lines), bins)
    return count.reshape(shape), mean_depth.reshape(shape), mean_level.reshape(shape)


def fit_profiles(
    count: Floats,
    depth: Floats,
    level: Floats,
    wall: Floats,
    model: ProfileModel,
) -> EdgeShifts:
    """Return the shift of each profile: iterated linear least squares on the model of the module's docstring."""
    pieces = len(count)
    wide = wall > WIDE_WALL_PX
    strip = np.where(wide, 0.0, wall)[:, None]
    inside = _mean_where(level, count, depth > model.reach_px - 2.0)
    outside = _mean_where(level, count, depth < -(outer_reach(wall, model.reach_px) - 2.0)[:, None])
    grey_of_wall = model.wall_ratio * inside
    step = np.zeros(pieces)
    if not model.near:
        step = _starting_shift(count, depth, level, inside, outside, grey_of_wall, strip[:, 0], model.reach_px)
    normal = np.zeros((pieces, COLUMNS, COLUMNS))
    moving = np.ones(pieces, np.bool_)
    variance = np.zeros(pieces)
    pixels = count.sum(axis=1)
    s = model.sigma_px
    for _ in range(ITERATIONS):
        near = (depth + step[:, None]) / s
        far = near + strip / s
        upper, both = ndtr(near), ndtr(far)
        bell_near = np.exp(-0.5 * near * near) / (s * SQRT_2_PI)
        bell_far = np.exp(-0.5 * far * far) / (s * SQRT_2_PI)
        slope_of_step = (inside - grey_of_wall)[:, None] * bell_near + (grey_of_wall - outside)[:, None] * bell_far
        columns = np.stack(
            [upper, 1.0 - both, both - upper, slope_of_step, depth * upper, depth * (1.0 - both)], axis=1
        )
        weighted = columns * count[:, None, :]
        now = weighted @ columns.transpose(0, 2, 1)
        right = (weighted @ level[:, :, None])[:, :, 0]
        # What is known of the wall: its grey is wall_ratio times that of the upper face.
        known = np.maximum(variance, 1.0) / np.maximum((model.wall_ratio_sigma * inside) ** 2, 1.0)
        now[:, 2, 2] += known
        now[:, 0, 0] += known * model.wall_ratio**2
        now[:, 0, 2] -= known * model.wall_ratio
        now[:, 2, 0] -= known * model.wall_ratio
        now += np.eye(COLUMNS) * 1e-6
        # A flat profile says nothing about the step: hold it.
        now[:, STEP, STEP] += 1e-3
        solution: Floats = np.linalg.solve(now, right[:, :, None])[:, :, 0].astype(np.float64, copy=False)
        error = level - (columns.transpose(0, 2, 1) @ solution[:, :, None])[:, :, 0]
        scatter = np.sum(count * error * error, axis=1) / np.maximum((count > 0).sum(axis=1) - COLUMNS, 1)
        change = np.clip(solution[:, STEP], -1.5, 1.5)
        normal = np.where(moving[:, None, None], now, normal)
        variance = np.where(moving, scatter, variance)
        inside, outside = np.where(moving, solution[:, 0], inside), np.where(moving, solution[:, 1], outside)
        grey_of_wall = np.where(moving, solution[:, 2], grey_of_wall)
        step = np.clip(np.where(moving, step + change, step), -model.reach_px, model.reach_px)
        moving &= np.abs(change) >= CONVERGED_PX
    spread = np.linalg.inv(normal)[:, STEP, STEP]
    sigma = np.sqrt(np.maximum(spread * np.maximum(variance, 0.25), 1e-12))
    contrast = np.abs(inside - np.where(strip[:, 0] > 2.0 * s, grey_of_wall, outside))
    valid = (pixels >= 40) & (sigma < 0.5) & (np.abs(step) < model.reach_px - 2.0 * s)
    valid &= contrast > np.maximum(4.0, 0.02 * np.abs(inside))
    return EdgeShifts(step, sigma, inside, outside, grey_of_wall, valid, variance)


def _mean_where(level: Floats, count: Floats, where: npt.NDArray[np.bool_]) -> Floats:
    weight = count * where
    return np.sum(weight * level, axis=1) / np.maximum(weight.sum(axis=1), 1.0)


def _starting_shift(
    count: Floats,
    depth: Floats,
    level: Floats,
    inside: Floats,
    outside: Floats,
    grey_of_wall: Floats,
    strip: Floats,
    reach: float,
) -> Floats:
    """Return where a sharp step would enclose the same light."""
    contrast = inside - outside
    contrast = np.where(np.abs(contrast) < 1.0, 1.0, contrast)
    share = (level - outside[:, None]) / contrast[:, None]
    full = np.sum(count * share, axis=1) / np.maximum(count.sum(axis=1), 1.0)
    deepest = np.max(np.where(count > 0, -depth, 0.0), axis=1)
    wall_light = strip * np.clip((grey_of_wall - outside) / contrast, 0.0, 1.0)
    return np.clip(full * (deepest + reach) - reach - wall_light, 3.0 - reach, reach - 3.0)
