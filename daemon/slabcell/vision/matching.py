"""Which blob may be which slot, and how does it lie?  Registration of whole outlines, keeping the orientation.

Every blob is laid over every slot of about its size, in the best of all rotations at once: the correlation of two
outlines over all starting points is one product of their Fourier transforms, and at each starting point the best
rotation has a closed form.  A mirror image does not fit, because both outlines run counter-clockwise.

Sources: B. Horn, "Closed-form solution of absolute orientation", JOSA A 4(4), 1987, in the plane; R. Jonker,
A. Volgenant, Computing 38, 1987, for the assignment (as in SciPy).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from slabcell.geometry import RigidTransform2D
from slabcell.vision.shapes import SAMPLES, Shapes

__all__ = ["Candidate", "MatchLimits", "assign", "find_candidates"]

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

# The correlation is interpolated to this many starting points.
FINE = 2 * SAMPLES
# Rotations of one pair that are looked at further.
MAX_ROTATIONS = 4
# How often an outline is laid over the other anew, and how far along it, in samples, the nearest point is looked for.
REFINEMENTS = 3
WINDOW = 3
# Of the blob's samples one of two is compared.
EVERY = 2
# Laid over the blob, another candidate may be off by CLOSE floors more than the best; a distance counts to FAR of them.
CLOSE, FAR = 3.0, 20.0
# What a step moves by less than so many floors lies still.
STILL = 0.2


class Candidate(NamedTuple):
    """A slot laid over a blob: table = motion·assembly, turned by ``rotation`` (rad) and moved by ``x_mm``, ``y_mm``.

    ``distance_mm`` is the RMS distance of the two outlines, a uniform offset left free.  A tuple, because many are made
    for each picture.
    """

    blob: int
    slot: int
    rotation: float
    x_mm: float
    y_mm: float
    distance_mm: float

    @property
    def motion(self) -> RigidTransform2D:
        """Table = motion·assembly."""
        return RigidTransform2D(math.degrees(self.rotation), self.x_mm, self.y_mm)


@dataclass(frozen=True, slots=True, eq=False)
class MatchLimits:
    """What outlines are compared, and which results count.

    ``distance_mm`` (slots,): RMS distance above which an outline is not this slot.  ``area``, ``inertia``: relative
    differences above which two outlines are not compared.  ``margin_mm``, ``worse``: another candidate of a blob may be
    so much and so many times worse than its best.  ``symmetry_order`` (slots,): of rotations that look alike only the
    best counts; ``same_deg``: rotations that differ by less are one.  ``floor_mm``: what an outline scatters at least.
    """

    distance_mm: Floats
    symmetry_order: Sequence[int]
    margin_mm: float
    floor_mm: float
    area: float
    inertia: float = 0.12
    worse: float = 1.6
    same_deg: float = 8.0


def find_candidates(
    blobs: Shapes, slots: Shapes, limits: MatchLimits, allowed: npt.NDArray[np.bool_] | None = None
) -> list[Candidate]:
    """Return what each blob may be: everything nearly as good as the best of that blob.

    ``slots`` have normals.  ``allowed`` (blobs, slots): pairs to compare, instead of those that agree in area and
    inertia.  This is the reference of `kernel`.
    """
    if len(blobs) == 0 or len(slots) == 0:
        return []
    if allowed is None:
        with np.errstate(divide="ignore"):
            area = np.abs(np.log(blobs.area_mm2[:, None]) - np.log(slots.area_mm2))
            inertia = np.abs(np.log(blobs.inertia[:, None]) - np.log(slots.inertia))
        allowed = (area <= math.log1p(limits.area)) & (inertia <= math.log1p(limits.inertia))
    # Turning and starting elsewhere leave the magnitudes of the harmonics: what they differ by, the outlines differ by.
    apart = blobs.spectra.magnitudes[:, None, :] - slots.spectra.magnitudes
    compared: npt.NDArray[np.bool_] = allowed & (np.sum(apart**2, axis=2) <= (limits.distance_mm * SAMPLES) ** 2)
    found: list[Candidate] = []
    for blob, fitting in enumerate(compared):
        peaks = [
            (slot, *peak)
            for slot in np.flatnonzero(fitting).tolist()
            for peak in _peaks(blobs, slots, blob, slot, limits)
        ]
        best = min((distance for *_, distance in peaks), default=0.0)
        laid: list[tuple[int, float, float, float, float]] = [
            (slot, *_refined(blobs, slots, blob, slot, start, turn, limits.floor_mm))
            for slot, start, turn, distance in peaks
            if distance <= limits.worse * best + limits.margin_mm
        ]
        closest = min((distance for *_, distance in laid), default=0.0)
        kept: list[Candidate] = []
        for slot, rotation, x, y, distance in laid:
            if distance > limits.worse * closest + CLOSE * limits.floor_mm:
                continue
            step = 2.0 * math.pi / limits.symmetry_order[slot]
            turns = [(rotation - other.rotation) / step for other in kept if other.slot == slot]
            if all(abs(turn - round(turn)) * step > math.radians(limits.same_deg) for turn in turns):
                kept.append(Candidate(blob, slot, rotation, x, y, distance))
        found += kept
    return found


def _peaks(blobs: Shapes, slots: Shapes, blob: int, slot: int, limits: MatchLimits) -> list[tuple[int, float, float]]:
    """Return starting point (of FINE), rotation (rad) and distance of the rotations that fit, best first."""
    product = blobs.spectra.values[blob] * np.conj(slots.spectra.values[slot])
    padded = np.zeros(FINE, np.complex128)
    padded[: SAMPLES // 2], padded[-SAMPLES // 2 :] = product[: SAMPLES // 2], product[SAMPLES // 2 :]
    # Mean over the samples of blob·conj(slot) for every starting point.
    overlap = np.fft.ifft(padded) * (FINE / SAMPLES**2)
    strength = np.abs(overlap)
    energy = (blobs.spectra.energy[blob] + slots.spectra.energy[slot]) / SAMPLES**2
    square = energy - 2.0 * strength
    peak = (
        (square <= limits.distance_mm[slot] ** 2)
        & (strength >= np.roll(strength, 1))
        & (strength > np.roll(strength, -1))
    )
    starts = np.flatnonzero(peak)
    starts = starts[np.argsort(square[starts], kind="stable")][:MAX_ROTATIONS]
    return [(int(at), float(np.angle(overlap[at])), math.sqrt(max(float(square[at]), 0.0))) for at in starts]


def _refined(
    blobs: Shapes, slots: Shapes, blob: int, slot: int, start: int, rotation: float, floor_mm: float
) -> tuple[float, float, float, float]:
    """Return rotation (rad), x and y that lay the slot's outline over the blob's, and how far it is then off.

    That goes by the distances along its normals, a uniform offset left free; their root mean square, before the last
    step and with far ones cut, is the last that is returned.

    Gauss-Newton with Cauchy's weights: A. Fitzgibbon, "Robust registration of 2D and 3D point sets", Image and Vision
    Computing 21, 2003, in its simplest form.
    """
    outline, model, normals = blobs.samples[blob], slots.samples[slot], slots.normals
    if normals is None:
        msg = "the slots' outlines were described without normals"
        raise ValueError(msg)
    shift = (start * SAMPLES + FINE // 2) // FINE
    compared = np.arange(0, SAMPLES, EVERY)
    near = (compared[:, None] - shift + np.arange(-WINDOW, WINDOW + 1)) % SAMPLES
    place, spread, distance = 0j, 8.0 * floor_mm, 0.0
    for step in range(REFINEMENTS):
        turn = np.exp(1j * rotation)
        points, outward = model * turn, normals[slot] * turn
        reach = max(1.0, float((np.abs(points.real) + np.abs(points.imag)).max()))
        there = outline[compared] - place
        nearest = near[np.arange(len(compared)), np.argmin(np.abs(there[:, None] - points[near]), axis=1)]
        normal = outward[nearest]
        away = (np.conj(normal) * (there - points[nearest])).real
        lever = (np.conj(1j * there) * normal).real / reach
        rows = np.column_stack([normal.real, normal.imag, lever, np.ones(len(compared))])
        weight = 1.0 / (1.0 + (away / spread) ** 2)
        cut: Floats = np.minimum(away**2, (FAR * floor_mm) ** 2).astype(np.float64, copy=False)
        distance = math.sqrt(float(cut.mean()))
        left = rows.T @ (weight[:, None] * rows) + 1e-3 * np.eye(4)
        change: list[float] = np.asarray(np.linalg.solve(left, rows.T @ (weight * away)), np.float64).tolist()
        place += complex(change[0], change[1])
        rotation += change[2] / reach
        if step > 0 and max(abs(value) for value in change[:3]) < STILL * floor_mm:
            break
        mean = float(np.sum(weight * np.minimum(np.abs(away), 4.0 * spread)) / max(float(weight.sum()), 1e-9))
        spread = max(2.0 * floor_mm, min(spread, 2.0 * mean))
    moved = blobs.middle[blob] + place - np.exp(1j * rotation) * slots.middle[slot]
    return rotation, float(moved.real), float(moved.imag), distance


def assign(cost: npt.NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return pairs (row, column), one to one, that fill as much as possible at the least total of ``cost``.

    Infinite entries are never used.
    """
    finite = np.isfinite(cost)
    if not np.any(finite):
        return []
    # A pair that must not be is dearer than every allowed pair together, so as few of them as possible are used.
    forbidden = 1.0 + float(cost[finite].max()) * (min(cost.shape) + 1)
    best = linear_sum_assignment(np.where(finite, cost, forbidden))
    return [(int(row), int(column)) for row, column in zip(*best, strict=True) if finite[row, column]]
