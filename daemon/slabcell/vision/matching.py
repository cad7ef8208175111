"""Which blob may be which slot, and how does it lie?  Registration of whole outlines, keeping the orientation.

Every blob is laid over every slot of about its size, in the best of all rotations at once: the correlation of two
outlines over all starting points is one product of their Fourier transforms, and at each starting point the best
rotation has a closed form.  A mirror image does not fit, because both outlines run counter-clockwise.

Sources: B. Horn, "Closed-form solution of absolute orientation", JOSA A 4(4), 1987, in the plane; R. Jonker,
A. Volgenant, Computing 38, 1987, for the assignment (as in SciPy).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from slabcell.geometry import RigidTransform2D
from slabcell.vision.describe import SAMPLES, Shapes

__all__ = ["Candidate", "assign", "find_candidates"]

# The correlation is interpolated to this many starting points.
FINE = 4 * SAMPLES
# Rotations of one pair that are looked at further.
MAX_ROTATIONS = 4
# Relative difference of the normalised polar inertia above which two outlines are not compared.
INERTIA_TOLERANCE = 0.12
# Candidates of one pair whose rotations differ by less than this are one.
SAME_ROTATION_DEG = 8.0
# Harmonics of the outlines, on either side, that are compared first, and what that may miss of the energy.
HARMONICS = 12
SLACK = 3e-3
# Pairs that are correlated at once, which bounds the memory.
BATCH = 512


@dataclass(frozen=True, slots=True)
class Candidate:
    """A slot laid over a blob: table = motion·assembly; ``distance_mm`` is the RMS distance of the two outlines."""

    blob: int
    slot: int
    motion: RigidTransform2D
    distance_mm: float


def find_candidates(
    blobs: Shapes,
    slots: Shapes,
    *,
    area_tolerance: float,
    limit_mm: npt.NDArray[np.float64],
    margin_mm: float,
    symmetry_order: Sequence[int],
    allowed: npt.NDArray[np.bool_] | None = None,
) -> list[Candidate]:
    """Return what each blob may be: everything nearly as good as the best of that blob.

    ``limit_mm`` (slots,): distance above which an outline is not this slot.  ``margin_mm``: how much worse than the
    best candidate of a blob another may be.  ``symmetry_order`` (slots,): of rotations that look alike only the best is
    returned.  ``allowed`` (blobs, slots): pairs to compare, instead of those that agree in area and inertia.
    """
    if len(blobs) == 0 or len(slots) == 0:
        return []
    pairs = np.argwhere(_alike(blobs, slots, area_tolerance) if allowed is None else allowed)
    found: list[Candidate] = []
    spectra = np.conj(np.fft.fft(slots.samples, axis=1))
    blob_spectra = np.fft.fft(blobs.samples, axis=1)
    for start in range(0, len(pairs), BATCH):
        batch = pairs[start : start + BATCH]
        found += _correlate(batch, blob_spectra, spectra, blobs, slots, limit_mm)
    best: dict[int, float] = {}
    for candidate in found:
        best[candidate.blob] = min(candidate.distance_mm, best.get(candidate.blob, np.inf))
    near_best = [item for item in found if item.distance_mm <= 1.6 * best[item.blob] + margin_mm]
    return _without_repetitions(near_best, symmetry_order)


def _alike(blobs: Shapes, slots: Shapes, area_tolerance: float) -> npt.NDArray[np.bool_]:
    """Return which pairs agree in area and inertia: shape (blobs, slots)."""
    with np.errstate(divide="ignore"):
        area = np.abs(np.log(blobs.area_mm2[:, None] / slots.area_mm2))
        inertia = np.abs(np.log(blobs.inertia[:, None] / slots.inertia))
    return (area <= np.log1p(area_tolerance)) & (inertia <= np.log1p(INERTIA_TOLERANCE))


def _without_repetitions(found: list[Candidate], symmetry_order: Sequence[int]) -> list[Candidate]:
    kept: list[Candidate] = []
    for item in sorted(found, key=lambda item: (item.blob, item.slot, item.distance_mm)):
        step = 360.0 / symmetry_order[item.slot]
        same = [other for other in kept[-MAX_ROTATIONS:] if (other.blob, other.slot) == (item.blob, item.slot)]
        turns = [(item.motion.rotation_deg - other.motion.rotation_deg) / step for other in same]
        if all(abs(turn - round(turn)) * step > SAME_ROTATION_DEG for turn in turns):
            kept.append(item)
    return kept


def _correlate(
    pairs: npt.NDArray[np.intp],
    blob_spectra: npt.NDArray[np.complex128],
    slot_spectra: npt.NDArray[np.complex128],
    blobs: Shapes,
    slots: Shapes,
    limit_mm: npt.NDArray[np.float64],
) -> list[Candidate]:
    blob, slot = pairs.T
    # The coarse shape first, which tells most pairs apart: what the low harmonics differ by, the whole differs by too.
    low = np.r_[0:HARMONICS, SAMPLES - HARMONICS : SAMPLES]
    first, second = blob_spectra[:, low], slot_spectra[:, low]
    energy = np.sum(_square(first), axis=1)[blob] + np.sum(_square(second), axis=1)[slot]
    coarse = np.zeros((len(pairs), 8 * HARMONICS), np.complex128)
    product = first[blob] * second[slot]
    coarse[:, :HARMONICS], coarse[:, -HARMONICS:] = product[:, :HARMONICS], product[:, HARMONICS:]
    strongest = np.sqrt(_square(np.fft.ifft(coarse, axis=1, norm="forward")).max(axis=1))
    # Between two starting points tried, the correlation is higher by a share of the energy at most.
    hopeful = (energy - 2.0 * strongest) / SAMPLES**2 <= limit_mm[slot] ** 2 + SLACK * energy / SAMPLES**2
    blob, slot = blob[hopeful], slot[hopeful]
    product = blob_spectra[blob] * slot_spectra[slot]
    energy = (np.sum(_square(blob_spectra), axis=1)[blob] + np.sum(_square(slot_spectra), axis=1)[slot]) / SAMPLES**2
    padded = np.zeros((len(product), FINE), np.complex128)
    padded[:, : SAMPLES // 2] = product[:, : SAMPLES // 2]
    padded[:, -SAMPLES // 2 :] = product[:, SAMPLES // 2 :]
    # Mean over the samples of blob·conj(slot) for every starting point.
    overlap = np.fft.ifft(padded, axis=1) * (FINE / SAMPLES**2)
    strength = np.abs(overlap)
    # Near enough first: that leaves few places at which to look for maxima.
    square = energy[:, None] - 2.0 * strength
    rows, starts = np.nonzero(square <= (limit_mm[slot] ** 2)[:, None])
    here = strength[rows, starts]
    peak = (here >= strength[rows, starts - 1]) & (here > strength[rows, (starts + 1) % FINE])
    rows, starts = rows[peak], starts[peak]
    distance = np.sqrt(np.maximum(square, 0.0))
    found: list[Candidate] = []
    order = np.lexsort((distance[rows, starts], rows))
    taken: dict[int, int] = {}
    for index in order:
        row, begin = int(rows[index]), int(starts[index])
        if taken.setdefault(row, 0) >= MAX_ROTATIONS:
            continue
        taken[row] += 1
        turn = overlap[row, begin] / strength[row, begin]
        moved = blobs.middle[blob[row]] - turn * slots.middle[slot[row]]
        motion = RigidTransform2D(float(np.rad2deg(np.angle(turn))), float(moved.real), float(moved.imag))
        found.append(Candidate(int(blob[row]), int(slot[row]), motion, float(distance[row, begin])))
    return found


def _square(values: npt.NDArray[np.complex128]) -> npt.NDArray[np.float64]:
    return values.real**2 + values.imag**2


def assign(cost: npt.NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return pairs (row, column), one to one, that fill as much as possible at the least total of ``cost``.

    Infinite entries are never used.
    """
    finite = np.isfinite(cost)
    if not np.any(finite):
        return []
    # A pair that must not be is dearer than every allowed pair together, so as few of them as possible are used.
    forbidden = 1.0 + float(cost[finite].max()) * (min(cost.shape) + 1)
    rows, columns = linear_sum_assignment(np.where(finite, cost, forbidden))
    return [(int(row), int(column)) for row, column in zip(rows, columns, strict=True) if finite[row, column]]
