"""Which implementation measures the edges?  The compiled kernel where there is one, else the reference in NumPy.

The kernel is plain C (``_kernel.c``), compiled when the package is built or installed, if a C compiler is there.  Both
give the same numbers; the kernel is some twenty times faster.  `implementation` says which one is used.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from slabcell.vision import edge_profile
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.pixels import Grey

__all__ = ["LIBRARY", "implementation", "measure_edges"]

LIBRARY: Final = Path(__file__).with_name("_kernel.so")
VERSION: Final = 3
# As in _kernel.c.
TABLE_REACH, TABLE_STEPS = 7, 64
RESULT_FIELDS = 7


def implementation() -> str:
    """Return ``native`` where the compiled kernel measures edges, ``numpy`` where the reference does."""
    return "numpy" if _library() is None else "native"


def measure_edges(grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
    """Return how far outward of its expected place each piece of edge lies."""
    library = _library()
    if library is None or len(lines) == 0:
        return edge_profile.measure_edges(grey, lines, model)
    wide = np.dtype(grey.dtype).itemsize == 2
    measure = library.slabcell_measure_edges_u16 if wide else library.slabcell_measure_edges_u8
    fields = np.column_stack([lines.middle, lines.outward, lines.half, lines.bend, lines.wall])
    table = np.ascontiguousarray(fields, np.float64)
    parameters = np.array(
        [model.sigma_px, model.reach_px, model.wall_ratio, model.wall_ratio_sigma, model.near], np.float64
    )
    results = np.empty((len(lines), RESULT_FIELDS))
    height, width = grey.shape
    picture = np.ascontiguousarray(grey)
    measure(
        picture.ctypes.data,
        width,
        width,
        height,
        len(lines),
        table.ctypes.data,
        parameters.ctypes.data,
        _normal_distribution().ctypes.data,
        results.ctypes.data,
    )
    shift, sigma, inside, outside, wall, valid, scatter = results.T
    return EdgeShifts(shift, sigma, inside, outside, wall, valid > 0.5, scatter)


@cache
def _library() -> ctypes.CDLL | None:
    """Return the compiled kernel, or None where it was not built or is of another version."""
    try:
        library = ctypes.CDLL(str(LIBRARY))
        version = library.slabcell_kernel_version()
    except (OSError, AttributeError):
        return None
    if version != VERSION:
        return None
    pointer, size, number = ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int
    for function in (library.slabcell_measure_edges_u8, library.slabcell_measure_edges_u16):
        function.argtypes = [pointer, size, number, number, number, pointer, pointer, pointer, pointer]
        function.restype = None
    return library


@cache
def _normal_distribution() -> npt.NDArray[np.float64]:
    """Return density and integral of the normal distribution, in turn, at the nodes of the kernel's table."""
    nodes = np.arange(2 * TABLE_REACH * TABLE_STEPS + 1) / TABLE_STEPS - TABLE_REACH
    density = np.exp(-0.5 * nodes * nodes) / np.sqrt(2.0 * np.pi)
    return np.ascontiguousarray(np.column_stack([density, ndtr(nodes)]))
