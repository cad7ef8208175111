"""How exactly does a slab lie?  The slot's outline is fitted to the edges in the raw pixels.

Pieces of the outline are projected into the picture with the lens model, their shifts are measured there
(`edge_profile`), and a rigid motion and one uniform offset (the kerf of the saw: slabs are often a little smaller or
larger than drawn) are solved for by robust least squares.  All candidates of a picture are solved together.

This is the reference implementation, composed of the references of its steps; `kernel` runs the same in C where that
was compiled.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from slabcell.geometry import RigidTransform2D, normalize_deg
from slabcell.vision.edge_profile import ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses
from slabcell.vision.edges import EdgePieces
from slabcell.vision.local_map import MARGIN_PX, LocalMaps, map_locally
from slabcell.vision.look import Judgement, Look, look
from slabcell.vision.matching import Candidate
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.picture_model import FIRST_MODEL, picture_model
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PlaneView

Floats = npt.NDArray[np.float64]

__all__ = ["Registration", "register", "registrations_of"]

# Another look is taken after a motion of more than this, at most LOOKS in all.
AGAIN_PX = 0.25
LOOKS = 3
# What nothing measures (a part without edges in some direction) is held where it is by this weight, in pixels.
PRIOR_SHARE = 1e-2
# What the model of an edge leaves out, per piece: no measurement is trusted better than this.
FLOOR_PX = 0.012
# What the model of a wall leaves out shifts all pieces of an outline alike, which their scatter does not show.
WALL_FLOOR_PX = 0.004
# A piece this far from the fitted outline does not support it.
SUPPORT_PX = 0.6
# A missing piece counts in `evidence_mm` as if it were this far off.
MISSING_PX = 3.0


class Registration(NamedTuple):
    """A candidate after its edges were measured.

    table = motion·assembly, turned by ``rotation`` (rad) and moved by ``x_mm``, ``y_mm``.  ``kerf_mm``: how far the
    slab's edge lies outside of the drawn one.  ``residual_mm``: RMS distance of the measured edges from the fitted
    outline.  ``coverage``: share of the outline that is where the fit says.  ``evidence_mm``: like the residual, with
    missing pieces counted, for comparing slots.  ``covariance``: of x, y (mm) and rotation (rad) of the slot's middle
    on the table, 3·3 numbers row by row.  A tuple, because many are made for each picture.
    """

    candidate: Candidate
    rotation: float
    x_mm: float
    y_mm: float
    kerf_mm: float
    residual_mm: float
    coverage: float
    evidence_mm: float
    covariance: Sequence[float]

    @property
    def motion(self) -> RigidTransform2D:
        """Table = motion·assembly."""
        return RigidTransform2D(normalize_deg(math.degrees(self.rotation)), self.x_mm, self.y_mm)


def register(
    grey: Grey, plane: PlaneView, outlines: OutlineSet, candidates: Sequence[Candidate], *, rough: bool
) -> list[Registration]:
    """Return every candidate with its pose, residual and covariance.

    ``outlines`` are those of the slots.  ``rough``: the candidates lie there only to some pixels, because
    walls that are seen have been taken off their outlines roughly, or because they are guesses.
    """
    if not candidates:
        return []
    poses = _initial(outlines, candidates)
    slots = np.array([candidate.slot for candidate in candidates], np.intp)
    whole: list[EdgePieces] = [outlines.pieces[slot] for slot in slots.tolist()]
    scale = plane.mm_per_px
    maps = map_locally(plane, poses.position, outlines.reaches_mm[slots] + MARGIN_PX * scale)
    judgement = Judgement(FLOOR_PX, PRIOR_SHARE / scale**2, SUPPORT_PX * scale, MISSING_PX * scale)

    def take(pieces: Sequence[EdgePieces], maps: LocalMaps, poses: Poses, model: ProfileModel) -> Look:
        return look(grey, Outlines.of(pieces), maps, poses, model, judgement, mirrored=plane.mirrored)

    if rough:
        poses = _moved(poses, take([item.few for item in whole], maps, poses, FIRST_MODEL).solution.change)
    model, offset = picture_model(grey, plane, whole, maps, poses, rough=rough)
    poses = replace(poses, kerf=poses.kerf + offset)
    covariance, spread = np.zeros((len(slots), 4, 4)), np.zeros(len(slots))
    coverage, residual, evidence = np.zeros(len(slots)), np.zeros(len(slots)), np.zeros(len(slots))
    # Another look only at what moved: a pose is exact when it is measured where it is.
    again = np.arange(len(slots))
    for _ in range(LOOKS):
        found = take(
            [whole[index] for index in again.tolist()], LocalMaps(maps.table[again]), poses.selected(again), model
        )
        change = found.solution.change
        poses = poses.replaced(again, _moved(poses.selected(again), change))
        covariance[again], spread[again] = found.solution.covariance, found.solution.spread
        coverage[again], residual[again], evidence[again] = found.coverage, found.residual_mm, found.evidence_mm
        moved = np.column_stack([change[:, :2], change[:, 2] * outlines.reaches_mm[slots[again]]])
        again = again[np.abs(moved).max(axis=1) > AGAIN_PX * scale]
        if len(again) == 0:
            break
    covariance = covariance[:, :3, :3] * _scatter(spread, coverage)[:, None, None]
    if rough:
        covariance[:, (0, 1), (0, 1)] += (WALL_FLOOR_PX * scale) ** 2
    cos, sin = np.cos(poses.rotation), np.sin(poses.rotation)
    x = poses.position[:, 0] - cos * poses.pivot[:, 0] + sin * poses.pivot[:, 1]
    y = poses.position[:, 1] - sin * poses.pivot[:, 0] - cos * poses.pivot[:, 1]
    rows = np.column_stack([poses.rotation, x, y, poses.kerf, residual, coverage, evidence])
    return registrations_of(candidates, np.column_stack([rows, covariance.reshape(-1, 9)]))


def registrations_of(candidates: Sequence[Candidate], rows: Floats) -> list[Registration]:
    """Return the candidates as they were found: ``rows`` (n, 16) hold rotation (rad), x, y, and what follows them."""
    return [
        Registration(candidate, turn, x, y, kerf, residual, coverage, evidence, covariance)
        for candidate, (turn, x, y, kerf, residual, coverage, evidence, *covariance) in zip(
            candidates, rows.tolist(), strict=True
        )
    ]


def _scatter(spread: Floats, coverage: Floats) -> Floats:
    """Return by how much the variances of each outline are greater or smaller than its pieces say.

    What the pieces of one outline tell is uncertain by a fifth or so: it is believed where it is more than what all
    outlines of the picture tell together.
    """
    good = np.sort(spread[(coverage > 0.9) & (spread > 0.0)])
    usual = good[len(good) // 2] if len(good) else 1.0
    return np.maximum(spread, usual) ** 2


def _initial(outlines: OutlineSet, candidates: Sequence[Candidate]) -> Poses:
    pivots = outlines.pivots[[candidate.slot for candidate in candidates]]
    rotation = np.array([candidate.rotation for candidate in candidates])
    position = [candidate.motion.apply(pivot) for candidate, pivot in zip(candidates, pivots, strict=True)]
    return Poses(rotation, np.array(position), pivots, np.zeros(len(candidates)))


def _moved(poses: Poses, change: Floats) -> Poses:
    return replace(
        poses,
        rotation=poses.rotation + change[:, 2],
        position=poses.position + change[:, :2],
        kerf=poses.kerf + change[:, 3],
    )
