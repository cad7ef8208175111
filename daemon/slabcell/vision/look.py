"""How does the picture answer a guess of poses?  One look: project the outlines, measure their edges, solve, judge.

This is the reference implementation, composed of the references of its steps; `kernel` runs the same in C where that
was compiled.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.vision import edge_profile, edge_projection, pose_solver
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses
from slabcell.vision.local_map import LocalMaps
from slabcell.vision.pixels import Grey
from slabcell.vision.pose_solver import Measured, Solution

__all__ = ["Judgement", "Look", "look"]

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Judgement:
    """How measured pieces are judged.

    ``floor_px``: what the model of an edge leaves out; no piece is trusted better.  ``prior``: weight (1/mm²) that
    holds what nothing measures where it is.  ``support_mm``: a piece farther off does not support the outline.
    ``missing_mm``: a missing piece counts as if it were this far off.
    """

    floor_px: float
    prior: float
    support_mm: float
    missing_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What one look found; arrays over outlines.

    ``coverage``: share of the outline that is where the solution says.  ``residual_mm``: RMS distance of the measured
    edges from it.  ``evidence_mm``: like the residual, with missing pieces counted.
    """

    lines: EdgeLines
    shifts: EdgeShifts
    solution: Solution
    coverage: Floats
    residual_mm: Floats
    evidence_mm: Floats


def look(
    grey: Grey,
    outlines: Outlines,
    maps: LocalMaps,
    poses: Poses,
    model: ProfileModel,
    judgement: Judgement,
    *,
    mirrored: bool,
) -> Look:
    """Return what a picture says about outlines that are assumed to lie as ``poses`` say."""
    edges = edge_projection.project(outlines, maps, poses, mirrored=mirrored)
    shifts = edge_profile.measure_edges(grey, edges.lines, model)
    sigma = np.sqrt(shifts.sigma**2 + judgement.floor_px**2) / edges.px_per_mm
    measured = Measured(outlines.starts, edges.extras, shifts.shift / edges.px_per_mm, sigma, shifts.valid)
    solution = pose_solver.solve(measured, judgement.prior)
    count, owner, share, valid = len(outlines), measured.owner, edges.share, shifts.valid
    square = solution.remains**2
    usable = np.where(valid, share, 0.0)
    near = np.abs(solution.remains) <= judgement.support_mm
    missing = judgement.missing_mm**2
    capped = np.where(valid, np.minimum(square, missing), missing)
    weight = np.bincount(owner, usable, minlength=count)
    return Look(
        edges.lines,
        shifts,
        solution,
        np.asarray(np.bincount(owner, np.where(near, usable, 0.0), minlength=count), np.float64),
        np.sqrt(np.bincount(owner, usable * square, minlength=count) / np.maximum(weight, 1e-9)),
        np.sqrt(np.bincount(owner, share * capped, minlength=count)),
    )
