"""How do values become the arrays that the kernel reads, and back?"""

import ctypes
import math
from functools import lru_cache
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from slabcell.vision.edge_profile import EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Poses
from slabcell.vision.matching import CLOSE, MatchLimits
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.part_poses import SlotTable
from slabcell.vision.plane import ForwardTable
from slabcell.vision.shapes import Shapes

__all__ = [
    "at",
    "normal_distribution",
    "of_forward",
    "of_limits",
    "of_model",
    "of_outlines",
    "of_poses",
    "of_shapes",
    "of_slot_table",
    "of_slots",
    "plain",
    "shifts",
]

Floats = npt.NDArray[np.float64]

# Of the kernel's table of the normal distribution, as in kernel.h.
TABLE_REACH, TABLE_STEPS = 7, 64


def at(array: npt.NDArray[Any]) -> int:
    """Return where an array's memory begins."""
    try:
        # The quickest way, which arrays that are empty or may not be written refuse.
        buffer: Any = array
        return ctypes.addressof(ctypes.c_char.from_buffer(buffer))
    except (TypeError, ValueError):
        return array.__array_interface__["data"][0]


def plain(array: npt.NDArray[Any], kind: Any = np.float64) -> npt.NDArray[Any]:
    """Return the array contiguous and of this type, itself where it is so already."""
    return np.ascontiguousarray(array, kind)


class Forward(ctypes.Structure):
    """The table from the plane to pixels, as in kernel.h."""

    _fields_: ClassVar = [
        ("grid", ctypes.c_void_p),
        ("rows", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("x0", ctypes.c_double),
        ("y0", ctypes.c_double),
        ("pitch", ctypes.c_double),
        ("flat", ctypes.c_int),
    ]


class Held(NamedTuple):
    """Addresses that a function of the kernel is given, and what must live as long as they are used."""

    addresses: tuple[int, ...]
    owners: tuple[object, ...]


def held(*arrays: npt.NDArray[Any]) -> Held:
    """Return the addresses of arrays, and the arrays."""
    return Held(tuple(at(array) for array in arrays), arrays)


# What is known of a product and a camera is the same for every picture: it is made ready for the kernel once.
KEPT: Final = 16


@lru_cache(maxsize=KEPT)
def of_forward(table: ForwardTable) -> Held:
    """Return the kernel's structure of a table."""
    rows, columns, _ = table.pixels.shape
    made = Forward(at(table.pixels), rows, columns, table.x_mm, table.y_mm, table.pitch_mm, int(table.flat))
    return Held((ctypes.addressof(made),), (made, table))


@lru_cache(maxsize=KEPT)
def of_slots(slots: Shapes) -> Held:
    """Return features, samples, spectra, energies, magnitudes and normals of slots."""
    if slots.normals is None:
        msg = "the slots' outlines were described without normals"
        raise ValueError(msg)
    return held(*of_shapes(slots), plain(slots.normals, np.complex128))


@lru_cache(maxsize=KEPT)
def of_limits(limits: MatchLimits) -> Held:
    """Return the limits of each slot, its symmetry, and the limits of all."""
    return held(
        plain(limits.distance_mm),
        np.array(limits.symmetry_order, np.float64),
        np.array(
            [
                *(math.log1p(limits.area), math.log1p(limits.inertia), limits.worse, limits.margin_mm),
                *(math.radians(limits.same_deg), limits.floor_mm, CLOSE * limits.floor_mm),
            ]
        ),
    )


@lru_cache(maxsize=KEPT)
def of_outlines(outlines: OutlineSet) -> Held:
    """Return where pieces begin and the pieces, of whole outlines, of few pieces and of probes; pivots and reaches."""
    kinds = (outlines.whole, outlines.few, outlines.probes)
    pieces = [part for item in kinds for part in (plain(item.starts, np.int64), plain(item.pieces))]
    return held(*pieces, plain(outlines.pivots), plain(outlines.reaches_mm))


@lru_cache(maxsize=KEPT)
def of_slot_table(slots: SlotTable) -> Held:
    """Return middles, grasp points, orders, corners and where those of each slot begin."""
    complexes = (plain(part, np.complex128) for part in (slots.middles, slots.grasp_points))
    return held(*complexes, plain(slots.orders), plain(slots.corners, np.complex128), plain(slots.starts, np.int64))


def of_shapes(shapes: Shapes) -> tuple[npt.NDArray[Any], ...]:
    """Return features, samples, spectra, energies and magnitudes as the kernel reads them."""
    features = np.empty((len(shapes), 4))
    features[:, 0], features[:, 1] = shapes.middle.real, shapes.middle.imag
    features[:, 2], features[:, 3] = shapes.area_mm2, shapes.inertia
    spectra = shapes.spectra
    return (
        features,
        plain(shapes.samples, np.complex128),
        plain(spectra.values, np.complex128),
        plain(spectra.energy),
        plain(spectra.magnitudes),
    )


def of_poses(poses: Poses) -> Floats:
    """Return the poses (n, 6) in the order of the kernel's fields."""
    placed = np.empty((len(poses.rotation), 6))
    placed[:, 0], placed[:, 5] = poses.rotation, poses.kerf
    placed[:, 1:3], placed[:, 3:5] = poses.position, poses.pivot
    return placed


def of_model(model: ProfileModel) -> Floats:
    """Return the model in the order of the kernel's structure."""
    return np.array(
        [
            *(model.sigma_px, model.reach_px, model.wall_ratio, model.wall_ratio_sigma),
            *(model.noise, model.grain_inside, model.grain_outside, model.grain_reach_px, model.least_scatter),
            *(float(model.near), float(model.fit_blur), model.wall_light_u, model.wall_light_v),
            *(model.slope_inside, model.slope_inside_sigma**-2.0),
            *(model.slope_outside, model.slope_outside_sigma**-2.0),
        ]
    )


def shifts(results: Floats) -> EdgeShifts:
    """Return what the kernel wrote of each piece, (n, RESULT_FIELDS)."""
    shift, sigma, inside, outside, wall, valid, *others = results.T
    return EdgeShifts(shift, sigma, inside, outside, wall, valid > 0.5, *others)


def normal_distribution() -> Floats:
    """Return density and integral of the normal distribution, in turn, at the nodes of the kernel's table."""
    nodes = np.arange(2 * TABLE_REACH * TABLE_STEPS + 1) / TABLE_STEPS - TABLE_REACH
    density = np.exp(-0.5 * nodes * nodes) / np.sqrt(2.0 * np.pi)
    return np.ascontiguousarray(np.column_stack([density, ndtr(nodes)]))
