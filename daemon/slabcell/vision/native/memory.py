"""How do values become the arrays that the kernel reads, and back?"""

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from slabcell.vision.edge_profile import EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Poses
from slabcell.vision.shapes import Shapes

__all__ = ["at", "normal_distribution", "of_model", "of_poses", "of_shapes", "plain", "shifts"]

Floats = npt.NDArray[np.float64]

# Of the kernel's table of the normal distribution, as in kernel.h.
TABLE_REACH, TABLE_STEPS = 7, 64


def at(array: npt.NDArray[Any]) -> int:
    """Return where an array's memory begins."""
    return array.__array_interface__["data"][0]


def plain(array: npt.NDArray[Any], kind: Any = np.float64) -> npt.NDArray[Any]:
    """Return the array contiguous and of this type, itself where it is so already."""
    return np.ascontiguousarray(array, kind)


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
        ]
    )


def shifts(results: Floats) -> EdgeShifts:
    """Return what the kernel wrote of each piece, (n, RESULT_FIELDS)."""
    shift, sigma, inside, outside, wall, valid, scatter, on_slab, on_table, blur = results.T
    return EdgeShifts(shift, sigma, inside, outside, wall, valid > 0.5, scatter, on_slab, on_table, blur)


def normal_distribution() -> Floats:
    """Return density and integral of the normal distribution, in turn, at the nodes of the kernel's table."""
    nodes = np.arange(2 * TABLE_REACH * TABLE_STEPS + 1) / TABLE_STEPS - TABLE_REACH
    density = np.exp(-0.5 * nodes * nodes) / np.sqrt(2.0 * np.pi)
    return np.ascontiguousarray(np.column_stack([density, ndtr(nodes)]))
