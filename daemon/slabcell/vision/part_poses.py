"""How are registered slabs picked and placed, in numbers?  All of a picture together.

This is the reference implementation, in NumPy; `kernel` runs the same in C where that was compiled.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.vision.plane import PlaneView
from slabcell.vision.registration import Registration

__all__ = ["PartPoses", "SlotTable", "part_poses"]

Complex = npt.NDArray[np.complex128]
Floats = npt.NDArray[np.float64]

# The part's X axis is drawn over this length to find its direction in the picture.
ARROW_PX = 5.0


@dataclass(frozen=True, eq=False)
class SlotTable:
    """What is asked of each slot, assembly frame, as x + iy in mm.

    ``middles`` (slots,): centroids; ``grasp_points`` (slots,), NaN where there is none; ``orders`` (slots,): rotations
    that look alike; ``corners``: of all slots one after the other; ``starts`` (slots + 1,): where those of each begin.
    """

    middles: Complex
    grasp_points: Complex
    orders: Floats
    corners: Complex
    starts: npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PartPoses:
    """``numbers`` (n, 13), one row for each slab; ``outlines``: its corners in the picture, (corners, 2) px.

    A row holds: rotation of the slab (degrees), and the motion back, x and y (mm); x and y of pick, then of place; u, v
    and direction (degrees) of the grasp point in the picture; standard deviations of x, y (mm) and rotation (degrees)
    there.
    """

    numbers: list[list[float]]
    outlines: list[Points]


def part_poses(plane: PlaneView, slots: SlotTable, chosen: Sequence[Registration]) -> PartPoses:
    """Return the poses of registered slabs, in the order given."""
    which = np.array([item.candidate.slot for item in chosen], np.intp)
    middles, points = slots.middles[which], slots.grasp_points[which]
    # Of the motions that look alike, the one that turns least, about the middle of the slot.
    turns = np.rad2deg([item.rotation for item in chosen])
    shifts = np.array([complex(item.x_mm, item.y_mm) for item in chosen], np.complex128)
    centres = np.exp(1j * np.deg2rad(turns)) * middles + shifts
    step = 360.0 / slots.orders[which]
    turns = turns - step * np.rint(turns / step)
    unit = np.exp(1j * np.deg2rad(turns))
    shifts = centres - unit * middles
    here = unit * points + shifts
    back = -np.conj(unit) * shifts
    tips = here + ARROW_PX * plane.mm_per_px * unit
    corners = [
        turn * slots.corners[slots.starts[slot] : slots.starts[slot + 1]] + shift
        for turn, slot, shift in zip(unit, which, shifts, strict=True)
    ]
    seen, tip = _seen(plane, here), _seen(plane, tips)
    angles = np.degrees(np.arctan2(seen[:, 1] - tip[:, 1], tip[:, 0] - seen[:, 0]))
    sigmas = _sigmas(np.array([item.covariance for item in chosen], np.float64).reshape(-1, 3, 3), here - centres)
    places = [turns, back.real, back.imag, here.real, here.imag, points.real, points.imag]
    numbers = np.column_stack([*places, seen, angles, sigmas])
    return PartPoses(numbers.tolist(), [_seen(plane, item) for item in corners])


def _seen(plane: PlaneView, places: Complex) -> Points:
    return plane.to_pixels(np.column_stack([places.real, places.imag]))


def _sigmas(covariance: Floats, arm: Complex) -> Floats:
    """Return standard deviations of x, y (mm) and rotation (degrees) at points ``arm`` beside the slots' middles."""
    right, up = arm.real, arm.imag
    xx, yy, tt = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2]
    x = xx - 2.0 * up * covariance[:, 0, 2] + up * up * tt
    y = yy + 2.0 * right * covariance[:, 1, 2] + right * right * tt
    variances = np.stack([x, y, tt * math.degrees(1.0) ** 2], axis=1)
    return np.sqrt(np.maximum(variances, 0.0))
