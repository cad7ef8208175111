"""How blurred is this picture, and how grainy are slabs and table?  Measured at a few of the edges in it.

Neither is known beforehand, and both decide how much each pixel tells about where an edge runs.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel, measure_edges
from slabcell.vision.edge_projection import Outlines, Poses, project
from slabcell.vision.edges import EdgePieces
from slabcell.vision.local_map import LocalMaps
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PlaneView

__all__ = ["FIRST_MODEL", "REACH_PX", "picture_model"]

Floats = npt.NDArray[np.float64]

# How far from an edge pixels are used, at first and then.
FIRST_REACH_PX: Final = 9.0
REACH_PX: Final = 6.0
# Once blur and slopes are known: so far, and so many widths of the blur.
NEAR_REACH_PX: Final = 4.0
REACH_BLURS: Final = 4.5
# Before the picture has been asked: blur, and grey of a wall over grey of the upper face.
SIGMA_PX: Final = 0.85
WALL_RATIO: Final = 0.6
FIRST_WALL_RATIO_SIGMA: Final = 0.3
FIRST_MODEL: Final = ProfileModel(SIGMA_PX, FIRST_REACH_PX, WALL_RATIO, FIRST_WALL_RATIO_SIGMA)
# How alike the walls of one picture are, if that cannot be measured, and within which limits that is believed.
WALL_RATIO_SIGMA: Final = 0.2
WALL_RATIO_RANGE: Final = (0.03, 0.3)
# How much lighter or darker walls are expected to be for where they face.
LIGHT_SIGMA: Final = 0.2
# Outlines that are asked.
PROBED: Final = 8
# What a surface's grain adds to the variance is at least this share of the sensor's.
NOISE_SHARE: Final = 0.5
# Grey levels squared: rounding to whole levels alone leaves this variance.
LEAST_NOISE: Final = 0.1
# How alike the slopes beside the edges are believed to be at most: grey levels per pixel, and as a share of what the
# variance of their measured values is.
LEAST_SLOPE_SIGMA: Final = 0.01
LEAST_SLOPE_SHARE: Final = 0.1


def picture_model(
    grey: Grey, plane: PlaneView, outlines: Sequence[EdgePieces], maps: LocalMaps, poses: Poses, *, rough: bool
) -> tuple[ProfileModel, float]:
    """Return what the edges of a picture are like, and by how much they lie outside of these outlines on the whole.

    It is asked at some of the outlines, which lie there to a pixel.  The second is in mm: the kerf, and that the
    threshold of the segmentation was not half way between slab and table.

    ``rough``: walls may be seen: more edges are asked.
    """
    chosen = np.unique(np.linspace(0, len(outlines) - 1, PROBED).astype(np.intp))
    asked: list[EdgePieces] = [outlines[index] for index in chosen.tolist()]
    probes = Outlines.of([item.few if rough else item.probes for item in asked])
    edges = project(probes, LocalMaps(maps.table[chosen]), poses.selected(chosen), mirrored=plane.mirrored)
    question = ProfileModel(SIGMA_PX, REACH_PX, WALL_RATIO, FIRST_WALL_RATIO_SIGMA, fit_blur=True)
    shifts = measure_edges(grey, edges.lines, question)
    wall = edges.lines.wall
    steep = shifts.valid & (np.abs(shifts.inside - shifts.outside) > 10.0)
    plain = steep & (wall < 0.5)
    if np.count_nonzero(plain) >= 6:
        steep = plain
    noise, inside, outside = _variances(shifts, steep)
    wall_ratio, by_u, by_v, wall_ratio_sigma = _walls(shifts, edges.lines)
    enough = np.count_nonzero(steep) >= 4
    offset = _middle((shifts.shift / edges.px_per_mm)[steep]) if enough else 0.0
    blur = _middle(shifts.blur[steep]) if enough else SIGMA_PX
    slope_inside, slope_inside_sigma = _slope(shifts.slope_inside[steep], shifts.slope_inside_variance[steep])
    slope_outside, slope_outside_sigma = _slope(shifts.slope_outside[steep], shifts.slope_outside_variance[steep])
    model = ProfileModel(
        blur,
        min(max(NEAR_REACH_PX, REACH_BLURS * blur), REACH_PX) if enough else REACH_PX,
        wall_ratio,
        wall_ratio_sigma,
        near=True,
        wall_light_u=by_u,
        wall_light_v=by_v,
        noise=noise,
        grain_inside=max(inside - noise, 0.0),
        grain_outside=max(outside - noise, 0.0),
        least_scatter=1.0,
        slope_inside=slope_inside,
        slope_inside_sigma=slope_inside_sigma,
        slope_outside=slope_outside,
        slope_outside_sigma=slope_outside_sigma,
    )
    return model, offset


def _middle(values: Floats) -> float:
    """Return the upper median, as the kernel does."""
    return float(np.sort(values)[len(values) // 2])


def _variances(shifts: EdgeShifts, usable: npt.NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return the variance of a pixel's grey from the sensor, and in all on slabs and on the table."""
    if np.count_nonzero(usable) < 4:
        return 1.0, 1.0, 1.0
    inside = max(_middle(shifts.scatter_inside[usable]), LEAST_NOISE)
    outside = max(_middle(shifts.scatter_outside[usable]), LEAST_NOISE)
    return NOISE_SHARE * min(inside, outside), inside, outside


def _slope(slopes: Floats, variances: Floats) -> tuple[float, float]:
    """Return the mean slope on one side of edges, and how much they truly differ: the spread less the measurement's."""
    if len(slopes) < 4:
        return 0.0, float("inf")
    mean = _middle(slopes)
    measured = (1.4826 * _middle(np.abs(slopes - mean))) ** 2
    true = max(measured - _middle(variances), LEAST_SLOPE_SHARE * measured, LEAST_SLOPE_SIGMA**2)
    return mean, float(np.sqrt(true))


def _walls(shifts: EdgeShifts, lines: EdgeLines) -> tuple[float, float, float, float]:
    """Return the grey of walls over that of upper faces: mean, how it grows with the normal's u and v, and scatter.

    A wall that faces the light is lighter than one that does not (Lambert): linear in its normal.
    """
    usable = shifts.valid & (shifts.inside > 1.0) & (lines.wall > 1.5)
    if np.count_nonzero(usable) < 6:
        return WALL_RATIO, 0.0, 0.0, WALL_RATIO_SIGMA
    ratios = np.clip(shifts.wall[usable] / shifts.inside[usable], 0.0, 1.5)
    columns = np.column_stack([np.ones(len(ratios)), lines.outward[usable]])
    prior = np.diag([0.0, *(2 * [(0.05 / LIGHT_SIGMA) ** 2])])
    weight = np.ones(len(ratios))
    scatter = WALL_RATIO_SIGMA
    solution: Floats = np.zeros(3)
    for _ in range(5):
        left = columns.T @ (weight[:, None] * columns) + prior
        solution = np.asarray(np.linalg.solve(left + 1e-9 * np.eye(3), columns.T @ (weight * ratios)), np.float64)
        away = np.abs(ratios - columns @ solution)
        scatter = float(np.clip(1.4826 * _middle(away), *WALL_RATIO_RANGE))
        weight = 1.0 / (1.0 + (away / (2.0 * scatter)) ** 2)
    mean, by_u, by_v = solution.tolist()
    return mean, by_u, by_v, scatter
