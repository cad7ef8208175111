"""How exactly does a slab lie?  The slot's outline is fitted to the edges in the raw pixels.

Pieces of the outline are projected into the picture with the lens model, their shifts are measured there
(`edge_profile`), and a rigid motion and one uniform offset (the kerf of the saw: slabs are often a little smaller or
larger than drawn) are solved for by robust least squares.  All candidates of a picture are solved together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Polygon, RigidTransform2D, normalize_deg
from slabcell.vision import kernel
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses, maps_of
from slabcell.vision.edges import EdgePieces
from slabcell.vision.kernel import Engine
from slabcell.vision.matching import Candidate
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PlaneView
from slabcell.vision.pose_solver import Measured, Solution

Floats = npt.NDArray[np.float64]

__all__ = ["Registration", "register"]

# How far from an edge pixels are used, at first and then.
FIRST_REACH_PX = 9.0
REACH_PX = 6.0
# Another look is taken after a motion of more than this.
AGAIN_PX = 0.05
# What nothing measures (a part without edges in some direction) is held where it is by this weight, in pixels.
PRIOR_SHARE = 1e-2
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
    poses = _initial(slots, candidates)
    whole = [pieces[candidate.slot] for candidate in candidates]
    maps = maps_of(plane, whole, poses)
    engine = kernel.engine()

    def step(outlines: Outlines, poses: Poses, model: ProfileModel) -> tuple[Measured, EdgeShifts, EdgeLines, Solution]:
        edges = engine.project(outlines, maps, poses, mirrored=plane.mirrored)
        shifts = engine.measure_edges(grey, edges.lines, model)
        sigma = np.sqrt(shifts.sigma**2 + FLOOR_PX**2) / edges.px_per_mm
        measured = Measured(outlines.starts, edges.extras, shifts.shift / edges.px_per_mm, sigma, shifts.valid)
        return measured, shifts, edges.lines, engine.solve(measured, PRIOR_SHARE / plane.mm_per_px**2)

    few = Outlines.of([item.thinned(FIRST_PIECES) for item in whole])
    _, shifts, lines, solution = step(few, poses, ProfileModel(SIGMA_PX, FIRST_REACH_PX, WALL_RATIO, 0.3))
    poses = _moved(poses, solution)
    sigma_px = _point_spread(engine, grey, lines, shifts)
    model = ProfileModel(sigma_px, REACH_PX, _wall_ratio(shifts, lines), WALL_RATIO_SIGMA, near=True)
    outlines = Outlines.of(whole)
    measured, _, _, solution = step(outlines, poses, model)
    poses = _moved(poses, solution)
    # A second look only where the first one moved something: a pose is exact when it is measured where it is.
    if float(np.abs(solution.change[:, :2]).max()) > AGAIN_PX * plane.mm_per_px:
        measured, _, _, solution = step(outlines, poses, model)
        poses = _moved(poses, solution)
    return _results(candidates, poses, measured, solution, plane.mm_per_px)


def _initial(slots: Sequence[Polygon], candidates: Sequence[Candidate]) -> Poses:
    pivots = np.array([slots[candidate.slot].centroid for candidate in candidates])
    rotation = np.deg2rad([candidate.motion.rotation_deg for candidate in candidates])
    shift = np.array([(candidate.motion.x_mm, candidate.motion.y_mm) for candidate in candidates])
    cos, sin = np.cos(rotation), np.sin(rotation)
    turned = np.column_stack([cos * pivots[:, 0] - sin * pivots[:, 1], sin * pivots[:, 0] + cos * pivots[:, 1]])
    return Poses(rotation, turned + shift, pivots, np.zeros(len(candidates)))


def _moved(poses: Poses, solution: Solution) -> Poses:
    change = solution.change
    return Poses(poses.rotation + change[:, 2], poses.position + change[:, :2], poses.pivot, poses.kerf + change[:, 3])


def _point_spread(engine: Engine, grey: Grey, lines: EdgeLines, shifts: EdgeShifts) -> float:
    """Return the width of the blur, in pixels: the one with which the model describes a picture's edges best."""
    steep = np.abs(shifts.inside - shifts.outside)
    usable = np.flatnonzero(shifts.valid & (lines.wall < 0.5) & (steep > 10.0))
    if len(usable) < 6:
        return SIGMA_PX
    chosen = lines.select(usable[:: max(1, len(usable) // SPREAD_PIECES)])
    scatter = np.array(
        [
            np.sort(engine.measure_edges(grey, chosen, ProfileModel(sigma, 6.0, WALL_RATIO, 0.3)).scatter)
            for sigma in SPREAD_PX
        ]
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


def _wall_ratio(shifts: EdgeShifts, lines: EdgeLines) -> float:
    """Return the grey of walls over that of upper faces, from the walls that are wide enough to be seen."""
    usable = shifts.valid & (shifts.inside > 1.0) & (lines.wall > 1.5)
    if not np.any(usable):
        return WALL_RATIO
    return float(np.clip(np.median(shifts.wall[usable] / shifts.inside[usable]), 0.0, 1.5))


def _results(
    candidates: Sequence[Candidate], poses: Poses, measured: Measured, solution: Solution, scale: float
) -> list[Registration]:
    count = len(candidates)
    owner, share, valid, remains = measured.owner, measured.extras[:, 5], measured.valid, solution.remains
    square = remains**2
    usable = np.where(valid, share, 0.0)
    coverage = np.bincount(owner, np.where(np.abs(remains) <= SUPPORT_PX * scale, usable, 0.0), minlength=count)
    weight = np.bincount(owner, usable, minlength=count)
    residual = np.sqrt(np.bincount(owner, usable * square, minlength=count) / np.maximum(weight, 1e-9))
    missing = (MISSING_PX * scale) ** 2
    capped = np.where(valid, np.minimum(square, missing), missing)
    evidence = np.sqrt(np.bincount(owner, share * capped, minlength=count))
    cos, sin = np.cos(poses.rotation), np.sin(poses.rotation)
    x = poses.position[:, 0] - cos * poses.pivot[:, 0] + sin * poses.pivot[:, 1]
    y = poses.position[:, 1] - sin * poses.pivot[:, 0] - cos * poses.pivot[:, 1]
    degrees = np.rad2deg(poses.rotation)
    return [
        Registration(
            candidate,
            RigidTransform2D(normalize_deg(float(degrees[index])), float(x[index]), float(y[index])),
            float(poses.kerf[index]),
            float(residual[index]),
            float(coverage[index]),
            float(evidence[index]),
            solution.covariance[index, :3, :3],
        )
        for index, candidate in enumerate(candidates)
    ]
