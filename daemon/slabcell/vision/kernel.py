"""Which implementation does the heavy work?  The compiled kernel where there is one, else the references in NumPy.

The kernel is plain C (``_kernel.c``), compiled when the package is built or installed, if a C compiler is there.  Both
give the same numbers; the kernel is some ten times faster.  `implementation` says which one is used.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from slabcell.vision import edge_profile, edge_projection, pose_solver
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses, ProjectedEdges
from slabcell.vision.local_map import LocalMaps
from slabcell.vision.pixels import Grey
from slabcell.vision.pose_solver import UNKNOWNS, Measured, Solution

__all__ = ["LIBRARY", "Engine", "NativeEngine", "NumpyEngine", "engine", "implementation", "measure_edges"]

LIBRARY: Final = Path(__file__).with_name("_kernel.so")
# As in _kernel.c.
VERSION: Final = 4
TABLE_REACH, TABLE_STEPS = 7, 64
RESULT_FIELDS, EXTRA_FIELDS = 7, 8


class Engine(Protocol):
    """The three steps of a registration, in one implementation."""

    @property
    def name(self) -> str:
        """Return ``native`` or ``numpy``."""
        ...

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """Return what `edge_projection.project` returns."""
        ...

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """Return what `edge_profile.measure_edges` returns."""
        ...

    def solve(self, measured: Measured, prior: float) -> Solution:
        """Return what `pose_solver.solve` returns."""
        ...


class NumpyEngine:
    """The references."""

    name = "numpy"

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """Return what `edge_projection.project` returns."""
        return edge_projection.project(outlines, maps, poses, mirrored=mirrored)

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """Return what `edge_profile.measure_edges` returns."""
        return edge_profile.measure_edges(grey, lines, model)

    def solve(self, measured: Measured, prior: float) -> Solution:
        """Return what `pose_solver.solve` returns."""
        return pose_solver.solve(measured, prior)


class NativeEngine:
    """The compiled kernel.  Raises OSError or AttributeError where it is missing, ValueError for another version."""

    name = "native"

    def __init__(self, path: Path = LIBRARY) -> None:
        library = ctypes.CDLL(str(path))
        version = library.slabcell_kernel_version()
        if version != VERSION:
            msg = f"{path} is version {version} of the kernel, this is {VERSION}: install slabcell again"
            raise ValueError(msg)
        pointer, size, number, real = ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int, ctypes.c_double
        self._measure = {1: library.slabcell_measure_edges_u8, 2: library.slabcell_measure_edges_u16}
        for function in self._measure.values():
            function.argtypes = [pointer, size, number, number, number, pointer, pointer, pointer, pointer]
            function.restype = None
        self._project = library.slabcell_project
        self._project.argtypes = [number, pointer, pointer, pointer, pointer, number, pointer, pointer]
        self._project.restype = None
        self._solve = library.slabcell_solve
        self._solve.argtypes = [number, pointer, pointer, pointer, real, pointer, pointer, pointer]
        self._solve.restype = None
        self._table = _normal_distribution()

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """Return what `edge_projection.project` returns."""
        count, pieces = len(outlines), len(outlines.pieces)
        placed = _columns(poses.rotation, poses.position, poses.pivot, poses.kerf)
        mapped = _columns(maps.centre, maps.size, maps.top.reshape(count, -1), maps.foot.reshape(count, -1))
        lines, extras = np.empty((pieces, 7)), np.empty((pieces, EXTRA_FIELDS))
        starts, table = _plain(outlines.starts, np.int64), _plain(outlines.pieces)
        self._project(
            count,
            starts.ctypes.data,
            table.ctypes.data,
            placed.ctypes.data,
            mapped.ctypes.data,
            int(mirrored),
            lines.ctypes.data,
            extras.ctypes.data,
        )
        return ProjectedEdges(EdgeLines(lines), extras)

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """Return what `edge_profile.measure_edges` returns."""
        picture, table = np.ascontiguousarray(grey), _plain(lines.table)
        height, width = picture.shape
        parameters = np.array(
            [model.sigma_px, model.reach_px, model.wall_ratio, model.wall_ratio_sigma, model.near], np.float64
        )
        results = np.empty((len(lines), RESULT_FIELDS))
        self._measure[picture.dtype.itemsize](
            picture.ctypes.data,
            width,
            width,
            height,
            len(lines),
            table.ctypes.data,
            parameters.ctypes.data,
            self._table.ctypes.data,
            results.ctypes.data,
        )
        shift, sigma, inside, outside, wall, valid, scatter = results.T
        return EdgeShifts(shift, sigma, inside, outside, wall, valid > 0.5, scatter)

    def solve(self, measured: Measured, prior: float) -> Solution:
        """Return what `pose_solver.solve` returns."""
        count = len(measured.starts) - 1
        given = _columns(measured.distance, measured.sigma, measured.valid)
        starts, extras = _plain(measured.starts, np.int64), _plain(measured.extras)
        change, covariance = np.empty((count, UNKNOWNS)), np.empty((count, UNKNOWNS, UNKNOWNS))
        remains = np.empty(len(given))
        self._solve(
            count,
            starts.ctypes.data,
            extras.ctypes.data,
            given.ctypes.data,
            prior,
            change.ctypes.data,
            covariance.ctypes.data,
            remains.ctypes.data,
        )
        return Solution(change, covariance, remains)


def implementation() -> str:
    """Return ``native`` where the compiled kernel is used, ``numpy`` where the references are."""
    return engine().name


def measure_edges(grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
    """Return how far outward of its expected place each piece of edge lies."""
    return engine().measure_edges(grey, lines, model)


@cache
def engine() -> Engine:
    """Return the fastest implementation that is there."""
    try:
        return NativeEngine()
    except (OSError, AttributeError, ValueError):
        return NumpyEngine()


def _columns(*parts: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    return np.ascontiguousarray(np.column_stack(parts), np.float64)


def _plain(array: npt.NDArray[Any], kind: Any = np.float64) -> npt.NDArray[Any]:
    return np.ascontiguousarray(array, kind)


def _normal_distribution() -> npt.NDArray[np.float64]:
    """Return density and integral of the normal distribution, in turn, at the nodes of the kernel's table."""
    nodes = np.arange(2 * TABLE_REACH * TABLE_STEPS + 1) / TABLE_STEPS - TABLE_REACH
    density = np.exp(-0.5 * nodes * nodes) / np.sqrt(2.0 * np.pi)
    return np.ascontiguousarray(np.column_stack([density, ndtr(nodes)]))
