"""Where does the edge run, beside where it was expected?  One shift per piece of edge, from the raw pixels.

Every pixel near a piece is sorted by its exact distance from the expected edge into narrow bins; the grey level over
that distance is the edge's profile.  A model is fitted to it: grey inside and outside, each with a slope (light and
contact shadows change slowly), a step blurred by a Gaussian point spread, and where the wall of a thick slab is visible
between both a strip of known width and nearly known grey.  The position of the step is what is asked; nothing is
interpolated.

Pixels do not count alike.  The sensor's noise is the same everywhere, but the grain of the slab disturbs its own side
of the edge, and the grain of the table the other: a pixel's weight is the inverse of the variance that both leave at
its depth.  Grain has long waves, which a mean and a slope follow less the farther from the edge: it counts more there.

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
# Half the length of a piece at most, and how far it bends away from its chord at most.
MAX_HALF_PX = 250.0
MAX_SAG_PX = 3.0
# Columns of the model: grey inside, outside, of the wall, step, slope inside, slope outside, width of the blur.
COLUMNS = 7
ON_WALL, STEP, SLOPE_IN, SLOPE_OUT, WIDTH = 2, 3, 4, 5, 6
SHIFT_AND_SLOPES = [STEP, SLOPE_IN, SLOPE_OUT]
ITERATIONS = 5
# After a step smaller than this the next one would be smaller than 1e-3 px.
CONVERGED_PX = 0.08
CONVERGED_BLUR = 0.02
# Bins this many widths of the blur from the edge show its two sides alone.
BESIDE = 2.0
# A wall wider than this is a second edge far enough away: the profile ends before it.
WIDE_WALL_PX = 14.0
SQRT_2_PI = float(np.sqrt(2.0 * np.pi))
# Farther from the step than this many widths of the blur nothing of it is left.
FARTHEST = 7.0


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
    ``wall_ratio``: grey of a wall over grey of the upper face, ``wall_light_u``, ``wall_light_v``: how that grows with
    the wall's outward normal in the picture, and ``wall_ratio_sigma`` how well it is known.
    ``near``: the edges are within a fraction of a pixel of where they are expected.  ``fit_blur``: find the point
    spread of each piece, too.

    ``noise``, ``grain_inside``, ``grain_outside``: variance of a pixel's grey from the sensor, and from the surfaces of
    slab and table at the edge; ``grain_reach_px``: distance at which the grain counts double.  ``least_scatter``: no
    piece is trusted as if it scattered less than this share of those variances.

    ``slope_inside``, ``slope_outside``: how fast the grey grows with the depth beside the edge, in grey levels per
    pixel, and with ``_sigma`` how alike that is at all edges of the picture; infinite where nothing is known.
    """

    sigma_px: float
    reach_px: float
    wall_ratio: float
    wall_ratio_sigma: float
    near: bool = False
    fit_blur: bool = False
    noise: float = 1.0
    grain_inside: float = 0.0
    grain_outside: float = 0.0
    grain_reach_px: float = 3.0
    least_scatter: float = 0.25
    wall_light_u: float = 0.0
    wall_light_v: float = 0.0
    slope_inside: float = 0.0
    slope_inside_sigma: float = float("inf")
    slope_outside: float = 0.0
    slope_outside_sigma: float = float("inf")

    def wall_ratios(self, lines: EdgeLines) -> Floats:
        """Return the expected grey of the wall of each piece over that of the upper face."""
        u, v = lines.outward.T
        return np.clip(self.wall_ratio + self.wall_light_u * u + self.wall_light_v * v, 0.0, 1.5)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeShifts:
    """Result of a measurement; arrays over pieces.

    ``shift`` px outward; ``sigma`` px, its standard deviation from the scatter about the model; ``inside``,
    ``outside``, ``wall``: grey levels at the edge; ``valid``: whether there is an edge that the model describes;
    ``scatter``: variance of the grey about the model over the variance that was expected; ``scatter_inside``,
    ``scatter_outside``: variance of a pixel's grey on either side of the edge; ``blur`` px: the point spread used;
    ``slope_inside``, ``slope_outside``: how fast the grey grows with the depth on either side, grey levels per pixel,
    and the ``_variance`` of that from the scatter.
    """

    shift: Floats
    sigma: Floats
    inside: Floats
    outside: Floats
    wall: Floats
    valid: npt.NDArray[np.bool_]
    scatter: Floats
    scatter_inside: Floats
    scatter_outside: Floats
    blur: Floats
    slope_inside: Floats
    slope_outside: Floats
    slope_inside_variance: Floats
    slope_outside_variance: Floats


def measure_edges(grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
    """Return how far outward of its expected place each piece of edge lies."""
    count, depth, level = collect_profiles(grey, lines, model)
    return fit_profiles(count, depth, level, lines.wall, model.wall_ratios(lines), model)


def outer_reach(wall: Floats, reach: float) -> Floats:
    """Return how far outside of each edge pixels are used: past the wall's foot, or short of it when it is wide."""
    return np.where(wall > WIDE_WALL_PX, WIDE_WALL_PX - 2.0, wall + reach)


def collect_profiles(grey: Grey, lines: EdgeLines, model: ProfileModel) -> tuple[Floats, Floats, Floats]:
    """Return for each piece and bin the number of pixels, their mean depth (px, inside positive) and mean grey."""
    height, width = grey.shape
    outer = outer_reach(lines.wall, model.reach_px)
    # A whole number of pixels, so that the bins are the same however many pieces are measured together.
    deepest = float(np.ceil(outer.max())) if len(lines) else 0.0
    bins = int(np.ceil((deepest + model.reach_px + 2.0 * MAX_SAG_PX) * BINS_PER_PX)) + 1
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
    # Which pixels belong to the piece is said by its chord.
    straight = -da * n_major[:, None, None] - db * n_minor[:, None, None]
    depth = straight + lines.bend[:, None, None] * t * t
    a_full = np.broadcast_to(a[:, :, None], b.shape)
    u = np.where(along_u[:, None, None], a_full, b)
    v = np.where(along_u[:, None, None], b, a_full)
    use = (np.abs(t) <= lines.half[:, None, None]) & (straight <= model.reach_px) & (straight >= -outer[:, None, None])
    use &= (np.abs(lines.bend * lines.half**2) <= MAX_SAG_PX)[:, None, None]
    use &= (lines.half <= MAX_HALF_PX)[:, None, None]
    use &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    piece, _, _ = np.nonzero(use)
    selected = depth[use]
    values = grey[v[use].astype(np.intp), u[use].astype(np.intp)].astype(np.float64)
    slot = piece * bins + np.floor((selected + deepest + MAX_SAG_PX) * BINS_PER_PX).astype(np.intp)
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
    wall_ratio: Floats,
    model: ProfileModel,
) -> EdgeShifts:
    """Return the shift of each profile: iterated linear least squares on the model of the module's docstring."""
    pieces = len(count)
    wide = wall > WIDE_WALL_PX
    strip = np.where(wide, 0.0, wall)[:, None]
    inside = _mean_where(level, count, depth > model.reach_px - 2.0)
    outside = _mean_where(level, count, depth < -(outer_reach(wall, model.reach_px) - 2.0)[:, None])
    grey_of_wall = wall_ratio * inside
    step = np.zeros(pieces)
    if not model.near:
        step = _starting_shift(count, depth, level, inside, outside, grey_of_wall, strip[:, 0], model.reach_px)
    moving = np.ones(pieces, np.bool_)
    scatter, spread, slopes = np.zeros(pieces), np.full((pieces, 3), 1e6), np.zeros((pieces, 2))
    error = np.zeros_like(level)
    s = np.full(pieces, model.sigma_px)
    unused = [] if model.fit_blur else [WIDTH]
    bins = (count > 0).sum(axis=1)
    known_slopes = (
        (SLOPE_IN, model.slope_inside, model.slope_inside_sigma**-2.0),
        (SLOPE_OUT, model.slope_outside, np.where(strip[:, 0] > 0.0, 0.0, model.slope_outside_sigma**-2.0)),
    )
    columns_used = COLUMNS - len(unused) - (strip[:, 0] <= 0.0)
    for _ in range(ITERATIONS):
        width = s[:, None]
        away = depth + step[:, None]
        near, far = away / width, (away + strip) / width
        upper, both = _integral(near), _integral(far)
        bell_near, bell_far = _bell(near) / width, _bell(far) / width
        first, second = (inside - grey_of_wall)[:, None], (grey_of_wall - outside)[:, None]
        columns = np.stack(
            [
                upper,
                1.0 - both,
                both - upper,
                first * bell_near + second * bell_far,
                depth * upper,
                depth * (1.0 - both),
                -(first * bell_near * near + second * bell_far * far),
            ],
            axis=1,
        )
        columns[:, unused] = 0.0
        weighted = columns * _weights(count, away, upper, strip, model)[:, None, :]
        now = weighted @ columns.transpose(0, 2, 1)
        right = (weighted @ level[:, :, None])[:, :, 0]
        # What is known of the slopes: that outside of an edge, not that at the foot of a wall.
        for column, mean, weight in known_slopes:
            now[:, column, column] += weight
            right[:, column] += mean * weight
        # What is known of the wall: its grey is wall_ratio times that of the upper face.
        known = np.maximum(scatter, 1.0 / model.noise) / np.maximum((model.wall_ratio_sigma * inside) ** 2, 1.0)
        known = np.where(strip[:, 0] > 0.0, known, 0.0)
        now[:, ON_WALL, ON_WALL] += known
        now[:, 0, 0] += known * wall_ratio**2
        now[:, 0, ON_WALL] -= known * wall_ratio
        now[:, ON_WALL, 0] -= known * wall_ratio
        now += np.eye(COLUMNS) * 1e-6
        # A flat profile says nothing about the step: hold it.
        now[:, STEP, STEP] += 1e-3 / model.noise
        now[:, WIDTH, WIDTH] += 1e-3 / model.noise
        solution: Floats = np.linalg.solve(now, right[:, :, None])[:, :, 0].astype(np.float64, copy=False)
        left = level - (columns.transpose(0, 2, 1) @ solution[:, :, None])[:, :, 0]
        weights = _weights(count, away, upper, strip, model)
        change = np.clip(solution[:, STEP], -1.5, 1.5)
        wider = np.clip(solution[:, WIDTH] / s, -0.3, 0.3)
        error = np.where(moving[:, None], left, error)
        spread = np.where(moving[:, None], np.linalg.inv(now)[:, SHIFT_AND_SLOPES, SHIFT_AND_SLOPES], spread)
        slopes = np.where(moving[:, None], solution[:, [SLOPE_IN, SLOPE_OUT]], slopes)
        scatter = np.where(moving, np.sum(weights * left * left, axis=1) / np.maximum(bins - columns_used, 1), scatter)
        inside, outside = np.where(moving, solution[:, 0], inside), np.where(moving, solution[:, 1], outside)
        from_wall = np.where(strip[:, 0] > 0.0, solution[:, ON_WALL], wall_ratio * solution[:, 0])
        grey_of_wall = np.where(moving, from_wall, grey_of_wall)
        step = np.clip(np.where(moving, step + change, step), -model.reach_px, model.reach_px)
        s = np.where(moving, np.clip(s * (1.0 + wider), 0.3, 4.0), s)
        moving = moving & ((np.abs(change) >= CONVERGED_PX) | (np.abs(wider) >= CONVERGED_BLUR))
    variance = spread * np.maximum(scatter, model.least_scatter)[:, None]
    sigma = np.sqrt(np.maximum(variance[:, 0], 1e-12))
    contrast = np.abs(inside - np.where(strip[:, 0] > 2.0 * s, grey_of_wall, outside))
    valid = (count.sum(axis=1) >= 40) & (sigma < 0.5) & (np.abs(step) < model.reach_px - 2.0 * s)
    valid &= contrast > np.maximum(4.0, 0.02 * np.abs(inside))
    away = depth + step[:, None]
    on_slab = _side(count, error, away > BESIDE * s[:, None])
    on_table = _side(count, error, -away - strip > BESIDE * s[:, None])
    return EdgeShifts(
        *(step, sigma, inside, outside, grey_of_wall, valid, scatter, on_slab, on_table, s),
        *(*slopes.T, *variance[:, 1:].T),
    )


def _weights(count: Floats, away: Floats, upper: Floats, strip: Floats, model: ProfileModel) -> Floats:
    """Return for each bin its number of pixels over their variance; ``away`` is the depth inside of the step."""
    beyond = np.where(away > 0.0, away, np.maximum(-away - strip, 0.0)) / model.grain_reach_px
    grain = model.grain_inside * upper**2 + model.grain_outside * (1.0 - upper) ** 2
    weights: Floats = count / (model.noise + grain * (1.0 + beyond**4))
    return weights


def _side(count: Floats, error: Floats, where: npt.NDArray[np.bool_]) -> Floats:
    """Return the variance of a pixel's grey about the model, from the bins ``where``."""
    filled = ((count > 0) & where).sum(axis=1)
    total: Floats = np.sum(np.where(where, count * error * error, 0.0), axis=1) / np.maximum(filled - 2.0, 1.0)
    return total


def _bell(x: Floats) -> Floats:
    density: Floats = np.exp(-0.5 * np.minimum(np.abs(x), FARTHEST) ** 2) / SQRT_2_PI
    return density


def _integral(x: Floats) -> Floats:
    return np.asarray(ndtr(np.clip(x, -FARTHEST, FARTHEST)), np.float64)


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
