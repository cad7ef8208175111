"""How exactly does a slab lie?  The slot's outline is fitted to the edges in the raw pixels.

Pieces of the outline are projected into the picture with the lens model, their shifts are measured there
(`edge_profile`), and a rigid motion and one uniform offset (the kerf of the saw: slabs are often a little smaller or
larger than drawn) are solved for by robust least squares.  All candidates of a picture are solved together.

Source of the weights: J. Tukey's biweight, as in P. Huber, "Robust Statistics", 1981.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Polygon, RigidTransform2D, normalize_deg
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Poses, ProjectedEdges, maps_of, project_through
from slabcell.vision.edges import EdgePieces
from slabcell.vision.kernel import measure_edges
from slabcell.vision.local_map import LocalMaps
from slabcell.vision.matching import Candidate
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PlaneView

Floats = npt.NDArray[np.float64]

__all__ = ["Registration", "register"]

# Unknowns of one part: x, y, rotation about its middle, uniform offset.
UNKNOWNS = 4
ROBUST_STEPS = 6
# Cut of Tukey's biweight in robust standard deviations.
TUKEY = 4.7
# What the model of an edge leaves out, per piece: no measurement is trusted better than this.
FLOOR_PX = 0.012
# A piece this far from the fitted outline does not support it.
SUPPORT_PX = 0.6
# A missing piece counts in `evidence_mm` as if it were this far off.
MISSING_PX = 3.0
# Before the picture has been asked: blur, and grey of a wall over grey of the upper face.
SIGMA_PX = 0.85
WALL_RATIO = 0.6
# How alike the walls of one picture are.
WALL_RATIO_SIGMA = 0.2
# Blurs that are tried, a constant factor apart.
SPREAD_PX = 0.55 * 1.25 ** np.arange(7)
SPREAD_PIECES = 24
# Pieces of each outline that are measured first, where the slab may be some pixels off.
FIRST_PIECES = 16


@dataclass(frozen=True, slots=True)
class Registration:
    """A candidate after its edges were measured.

    ``motion``: table = motion·assembly.  ``kerf_mm``: how far the slab's edge lies outside of the drawn one.
    ``residual_mm``: RMS distance of the measured edges from the fitted outline.  ``coverage``: share of the outline
    that is where the fit says.  ``evidence_mm``: like the residual, with missing pieces counted, for comparing slots.
    ``covariance`` (3, 3) of x, y (mm) and rotation (rad) of the slot's middle on the table.
    """

    candidate: Candidate
    motion: RigidTransform2D
    kerf_mm: float
    residual_mm: float
    coverage: float
    evidence_mm: float
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Measured pieces of all candidates on the table: distances in mm along the outward normal."""

    owner: npt.NDArray[np.intp]
    rows: Floats
    distance: Floats
    sigma: Floats
    valid: npt.NDArray[np.bool_]
    weight: Floats


def register(
    grey: Grey,
    plane: PlaneView,
    slots: Sequence[Polygon],
    pieces: Sequence[EdgePieces],
    candidates: Sequence[Candidate],
) -> list[Registration]:
    """Return every candidate with its pose, residual and covariance; ``pieces`` are those of each slot."""
    if not candidates:
        return []
    motions = [candidate.motion for candidate in candidates]
    pivots = np.array([slots[candidate.slot].centroid for candidate in candidates])
    poses = Poses(
        np.deg2rad([motion.rotation_deg for motion in motions]),
        np.array([motion.apply(pivot) for motion, pivot in zip(motions, pivots, strict=True)]),
        pivots,
        np.zeros(len(candidates)),
    )
    outlines = [pieces[candidate.slot] for candidate in candidates]
    maps = maps_of(plane, outlines, poses)
    scale = plane.mm_per_px
    model = ProfileModel(SIGMA_PX, 9.0, WALL_RATIO, 0.3)
    few = [item.thinned(FIRST_PIECES) for item in outlines]
    system, shifts, edges = _measure(grey, maps, few, poses, model, mirrored=plane.mirrored)
    poses, _, _ = _solve(system, poses, scale)
    model = ProfileModel(
        _point_spread(grey, edges.lines, shifts), 6.0, _wall_ratio(shifts, edges.lines), WALL_RATIO_SIGMA, near=True
    )
    covariance, remaining = np.zeros((0, UNKNOWNS, UNKNOWNS)), system.distance
    for _ in range(2):
        system, shifts, edges = _measure(grey, maps, outlines, poses, model, mirrored=plane.mirrored)
        poses, covariance, remaining = _solve(system, poses, scale)
    return _results(candidates, poses, system, covariance, remaining, scale)


def _measure(
    grey: Grey, maps: LocalMaps, outlines: Sequence[EdgePieces], poses: Poses, model: ProfileModel, *, mirrored: bool
) -> tuple[_System, EdgeShifts, ProjectedEdges]:
    edges = project_through(maps, outlines, poses, mirrored=mirrored)
    shifts = measure_edges(grey, edges.lines, model)
    system = _System(
        edges.owner,
        edges.rows,
        shifts.shift / edges.px_per_mm,
        np.hypot(shifts.sigma, FLOOR_PX) / edges.px_per_mm,
        shifts.valid,
        edges.share,
    )
    return system, shifts, edges


def _point_spread(grey: Grey, lines: EdgeLines, shifts: EdgeShifts) -> float:
    """Return the width of the blur, in pixels: the one with which the model describes a picture's edges best."""
    steep = np.abs(shifts.inside - shifts.outside)
    usable = np.flatnonzero(shifts.valid & (lines.wall < 0.5) & (steep > 10.0))
    if len(usable) < 6:
        return SIGMA_PX
    chosen = lines.select(usable[:: max(1, len(usable) // SPREAD_PIECES)])
    scatter = np.array(
        [np.sort(measure_edges(grey, chosen, ProfileModel(sigma, 6.0, WALL_RATIO, 0.3)).scatter) for sigma in SPREAD_PX]
    )
    # The worst third has something else beside its edge.
    total = scatter[:, : max(4, 2 * len(chosen) // 3)].sum(axis=1)
    best = int(np.clip(np.argmin(total), 1, len(SPREAD_PX) - 2))
    x = np.log(SPREAD_PX[best - 1 : best + 2])
    low, middle, high = total[best - 1 : best + 2]
    # Vertex of the parabola through three points of the logarithm, which are equally far apart.
    curvature = low - 2.0 * middle + high
    shift = 0.5 * (low - high) / curvature if curvature > 0.0 else 0.0
    return float(np.exp(x[1] + np.clip(shift, -1.0, 1.0) * (x[2] - x[1])))


def _solve(system: _System, poses: Poses, scale: float) -> tuple[Poses, Floats, Floats]:
    """Return the improved poses, the covariances (n, 4, 4) and the distances that remain (pieces,)."""
    count = len(poses.rotation)
    reach = np.hypot(*(system.rows[:, 2], np.ones(len(system.rows)))).max(initial=1.0)
    rows = system.rows / np.array([1.0, 1.0, reach, 1.0])
    base = np.where(system.valid, 1.0 / system.sigma**2, 0.0)
    robust = np.ones_like(base)
    unknown = np.zeros((count, UNKNOWNS))
    normal = np.zeros((count, UNKNOWNS, UNKNOWNS))
    remaining = system.distance
    chi = np.ones(count)
    for _ in range(ROBUST_STEPS):
        weight = base * robust
        normal = _per_owner(system.owner, weight[:, None, None] * rows[:, :, None] * rows[:, None, :], count)
        right = _per_owner(system.owner, (weight * system.distance)[:, None] * rows, count)
        # Directions without any edge (a lost part) are held where they are; the offset is known to be small.
        normal += np.eye(UNKNOWNS) * (1e-2 / scale**2)
        unknown = np.linalg.solve(normal, right[:, :, None])[:, :, 0].astype(np.float64, copy=False)
        remaining = system.distance - np.sum(rows * unknown[system.owner], axis=1)
        scaled = np.abs(remaining) / system.sigma
        spread = np.maximum(
            _median_per_owner(system.owner, np.where(system.valid, scaled, np.nan), count) / 0.6745, 0.5
        )
        chi = spread**2
        robust = np.maximum(1.0 - (scaled / (TUKEY * np.maximum(spread, 1.0)[system.owner])) ** 2, 0.0) ** 2
    unscale = np.array([1.0, 1.0, 1.0 / reach, 1.0])
    covariance: Floats = np.linalg.inv(normal).astype(np.float64, copy=False)
    covariance = covariance * np.maximum(chi, 1.0)[:, None, None] * (unscale[:, None] * unscale)
    change = unknown * unscale
    improved = Poses(
        poses.rotation + change[:, 2], poses.position + change[:, :2], poses.pivot, poses.kerf + change[:, 3]
    )
    return improved, covariance, remaining


def _per_owner(owner: npt.NDArray[np.intp], values: Floats, count: int) -> Floats:
    """Return sums over the pieces of each candidate; pieces of one candidate are neighbours."""
    starts = np.searchsorted(owner, np.arange(count))
    padded = np.concatenate([values, np.zeros((1, *values.shape[1:]))])
    sums = np.add.reduceat(padded, starts, axis=0)
    empty = np.bincount(owner, minlength=count) == 0
    sums[empty] = 0.0
    return sums


def _median_per_owner(owner: npt.NDArray[np.intp], values: Floats, count: int) -> Floats:
    """Return the median of the finite values of each candidate, 0 where there is none."""
    order = np.lexsort((values, owner))  # NaN sorts last
    usable = np.bincount(owner, np.isfinite(values), minlength=count).astype(np.intp)
    starts = np.searchsorted(owner, np.arange(count))
    at = np.minimum(starts + usable // 2, max(len(values) - 1, 0))
    return np.where(usable > 0, np.nan_to_num(values[order][at]), 0.0) if len(values) else np.zeros(count)


def _wall_ratio(shifts: EdgeShifts, lines: EdgeLines) -> float:
    """Return the grey of walls over that of upper faces, from the walls that are wide enough to be seen."""
    usable = shifts.valid & (shifts.inside > 1.0) & (lines.wall > 1.5)
    if not np.any(usable):
        return WALL_RATIO
    return float(np.clip(np.median(shifts.wall[usable] / shifts.inside[usable]), 0.0, 1.5))


def _results(
    candidates: Sequence[Candidate],
    poses: Poses,
    system: _System,
    covariance: Floats,
    remaining: Floats,
    scale: float,
) -> list[Registration]:
    count = len(candidates)
    usable = np.where(system.valid, system.weight, 0.0)
    supported = system.valid & (np.abs(remaining) <= SUPPORT_PX * scale)
    coverage = np.bincount(system.owner, np.where(supported, system.weight, 0.0), minlength=count)
    square = np.bincount(system.owner, usable * remaining**2, minlength=count)
    residual = np.sqrt(square / np.maximum(np.bincount(system.owner, usable, minlength=count), 1e-9))
    missing = (MISSING_PX * scale) ** 2
    capped = np.where(system.valid, np.minimum(remaining**2, missing), missing)
    evidence = np.sqrt(np.bincount(system.owner, system.weight * capped, minlength=count))
    results: list[Registration] = []
    for index, candidate in enumerate(candidates):
        rotation = normalize_deg(float(np.rad2deg(poses.rotation[index])))
        turned = RigidTransform2D(rotation, 0.0, 0.0).apply(poses.pivot[index])
        x, y = poses.position[index] - turned
        results.append(
            Registration(
                candidate,
                RigidTransform2D(rotation, float(x), float(y)),
                float(poses.kerf[index]),
                float(residual[index]),
                float(coverage[index]),
                float(evidence[index]),
                covariance[index][:3, :3],
            )
        )
    return results
