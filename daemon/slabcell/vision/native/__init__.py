"""How is the compiled kernel called?  Through ctypes, with arrays whose memory belongs to the caller.

The C sources lie beside this file.  They are compiled twice where the compiler can: for every processor of the kind,
and for x86-64-v3 (AVX2 and FMA), which is taken where the processor has that.
"""

import ctypes
import math
import threading
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError
from slabcell.geometry import Points
from slabcell.vision.contours import Contours
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses, ProjectedEdges
from slabcell.vision.local_map import MARGIN_PX, LocalMaps, map_locally, nodes_of_maps
from slabcell.vision.matching import CLOSE, FINE, MAX_ROTATIONS, Candidate, MatchLimits
from slabcell.vision.native.memory import (
    at,
    normal_distribution,
    of_model,
    of_poses,
    of_shapes,
    plain,
    shifts,
)
from slabcell.vision.outline import Rings
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.picture_model import (
    FIRST_REACH_PX,
    FIRST_WALL_RATIO_SIGMA,
    LEAST_NOISE,
    LIGHT_SIGMA,
    NOISE_SHARE,
    REACH_PX,
    SIGMA_PX,
    WALL_RATIO,
    WALL_RATIO_RANGE,
    WALL_RATIO_SIGMA,
)
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PixelTable, PlaneView
from slabcell.vision.pose_solver import UNKNOWNS, Measured, Solution
from slabcell.vision.registration import (
    AGAIN_PX,
    FLOOR_PX,
    MISSING_PX,
    PRIOR_SHARE,
    SUPPORT_PX,
    WALL_FLOOR_PX,
    Registration,
    registrations_of,
)
from slabcell.vision.shapes import HARMONICS, SAMPLES, Shapes, Spectra
from slabcell.vision.survey import Survey, step_of
from slabcell.vision.thresholds import LOGARITHMS, Split

__all__ = ["FAST_LIBRARY", "LIBRARY", "NativeEngine"]

LIBRARY: Final = Path(__file__).with_name("_kernel.so")
FAST_LIBRARY: Final = Path(__file__).with_name("_kernel_v3.so")
# As in kernel.h.
VERSION: Final = 6
LINE_FIELDS, RESULT_FIELDS, EXTRA_FIELDS, MAP_FIELDS, FOUND_FIELDS = 7, 10, 8, 63, 16
# Numbers that a registration has to remember of each candidate, and of each of its pieces.
REGISTER_OUTLINE, REGISTER_PIECE = 256, 48
FAST_LEVEL: Final = 3
# Rooms that are tried first: points of outlines, and outlines.
POINTS, OUTLINES = 1 << 16, 2048
# Outlines of more points than this are noise.
MAX_POINTS: Final = 1 << 24

Floats = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


class NativeEngine:
    """The compiled kernel.  Raises OSError or AttributeError where it is missing, ValueError for another version."""

    name = "native"

    def __init__(self, path: Path | None = None) -> None:
        self._library = library = _load(path)
        pointer, size, number, real = ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int, ctypes.c_double
        picture = [pointer, size, number, number]

        def function(name: str, *arguments: Any, result: Any = None) -> Any:
            found = getattr(library, "slabcell_" + name)
            found.argtypes, found.restype = arguments, result
            return found

        long = ctypes.c_int64
        self._survey = function("survey", *picture, number, *[pointer] * 3)
        self._trace = function(
            "trace",
            *picture,
            real,
            number,
            number,
            real,
            pointer,
            pointer,
            long,
            *[pointer] * 3,
            long,
            pointer,
            result=long,
        )
        self._to_plane = function("to_plane", pointer, number, number, real, long, pointer, pointer)
        self._describe = function(
            "describe", pointer, number, number, real, long, pointer, pointer, number, *[pointer] * 6
        )
        self._spectra = function("spectra", long, *[pointer] * 5)
        self._match = function("match", long, *[pointer] * 5, long, *[pointer] * 12, long, pointer, result=long)
        self._maps = function(
            "local_maps", pointer, number, number, real, real, real, number, pointer, pointer, number, *[pointer] * 3
        )
        self._to_pixels = function("to_pixels", pointer, number, number, real, real, real, long, pointer, pointer)
        self._project = function("project", number, *[pointer] * 4, number, pointer, pointer)
        self._solve = function("solve", number, pointer, pointer, pointer, real, *[pointer] * 4)
        self._measure = {
            kind: function(f"measure_edges_u{8 * kind}", *picture, number, *[pointer] * 4) for kind in (1, 2)
        }
        self._split = function("split", *[pointer] * 3, result=number)
        self._register = function(
            "register", *picture, number, *[pointer] * 10, number, *[pointer] * 3, number, long, *[pointer] * 3
        )
        self.level = int(library.slabcell_cpu_level())
        self._rooms = threading.local()
        self._table = normal_distribution()
        self._logarithms = np.ascontiguousarray(LOGARITHMS)
        turns = np.exp(-2j * np.pi * np.arange(FINE // 2) / FINE)
        self._roots = np.ascontiguousarray(turns.view(np.float64))

    def survey(self, picture: Picture) -> Survey:
        """See `survey.survey`."""
        height, width = picture.shape
        grey, difference, step = np.empty(256, np.int64), np.empty(256, np.int64), step_of(picture)
        steepest = np.empty(2 * -(-height // (2 * step)), np.uint8)
        self._survey(
            at(picture),
            width,
            width,
            height,
            step,
            at(grey),
            at(difference),
            at(steepest),
        )
        return Survey(grey, difference, steepest)

    def trace(self, picture: Picture, level: float, *, dark: bool, interpolate: bool, min_area_px: float) -> Contours:
        """See `contours.trace`.  Raises ImageError for outlines of more than MAX_POINTS points."""
        height, width = picture.shape
        points_room, outlines_room = POINTS, OUTLINES
        scratch = self._room(2 * (height + 2) * ((width + 63) // 64 + 2))
        while True:
            points, starts = np.empty((points_room, 2)), np.empty(outlines_room + 1, np.int64)
            areas, rims = np.empty(outlines_room), np.empty(outlines_room, np.uint8)
            totals = np.empty(2, np.int64)
            count = int(
                self._trace(
                    *(at(picture), width, width, height),
                    *(level, int(dark), int(interpolate), min_area_px),
                    *(
                        at(scratch),
                        at(points),
                        points_room,
                        at(starts),
                        at(areas),
                        at(rims),
                        outlines_room,
                        at(totals),
                    ),
                )
            )
            used, left_out = totals.tolist()
            if used <= points_room and count <= outlines_room:
                return Contours(points[:used], starts[: count + 1], areas[:count], rims[:count] > 0, left_out)
            if used > MAX_POINTS:
                msg = (
                    f"the regions of the picture have outlines of {used} points, {MAX_POINTS} are allowed: it is noise"
                )
                raise ImageError(msg)
            points_room, outlines_room = max(points_room, used), max(outlines_room, count)

    def _room(self, words: int) -> npt.NDArray[np.uint64]:
        """Return memory of this thread to work in, which is kept: fresh pages cost more than what is done in them."""
        room: npt.NDArray[np.uint64] | None = getattr(self._rooms, "words", None)
        if room is None or len(room) < words:
            room = self._rooms.words = np.empty(words, np.uint64)
        return room

    def to_plane(self, table: PixelTable, pixels: Points) -> Points:
        """See `plane.PixelTable.at`."""
        rows, columns, _ = table.mm.shape
        pixels, found = plain(pixels), np.empty((len(pixels), 2))
        self._to_plane(at(table.mm), rows, columns, table.pitch_px, len(pixels), at(pixels), at(found))
        return found

    def describe(self, rings: Rings) -> Shapes:
        """See `shapes.describe`."""
        return self._shapes(np.array(rings.points, np.float64, order="C"), rings.starts, None)

    def describe_pixels(self, table: PixelTable, pixels: Points, starts: npt.NDArray[np.int64]) -> Shapes:
        """See `kernel.Engine.describe_pixels`."""
        return self._shapes(plain(pixels), starts, table)

    def _shapes(self, points: Points, starts: npt.NDArray[np.int64], table: PixelTable | None) -> Shapes:
        count, starts = len(starts) - 1, plain(starts, np.int64)
        rows, columns, _ = (0, 0, 0) if table is None else table.mm.shape
        grid, pitch = (None, 1.0) if table is None else (at(table.mm), table.pitch_px)
        scratch = self._room(2 * int(np.diff(starts).max(initial=0)))
        samples, middle = np.empty((count, SAMPLES), np.complex128), np.empty(count, np.complex128)
        area, inertia, centroid = np.empty(count), np.empty(count), np.empty((count, 2))
        self._describe(
            *(grid, rows, columns, pitch, count, at(starts), at(points), SAMPLES, at(scratch)),
            *(at(samples), at(middle), at(area), at(inertia), at(centroid)),
        )
        values, energy = np.empty((count, SAMPLES), np.complex128), np.empty(count)
        magnitudes = np.empty((count, HARMONICS))
        self._spectra(
            count,
            at(samples),
            at(self._roots),
            at(values),
            at(energy),
            at(magnitudes),
        )
        return Shapes(samples, middle, area, inertia, centroid, Spectra(values, energy, magnitudes))

    def find_candidates(
        self, blobs: Shapes, slots: Shapes, limits: MatchLimits, allowed: npt.NDArray[np.bool_] | None = None
    ) -> list[Candidate]:
        """See `matching.find_candidates`."""
        if len(blobs) == 0 or len(slots) == 0 or slots.normals is None:
            return []
        mine, theirs = of_shapes(blobs), of_shapes(slots)
        distances, symmetries = plain(limits.distance_mm), np.array(limits.symmetry_order, np.float64)
        normals = plain(slots.normals, np.complex128)
        pairs = None if allowed is None else plain(allowed, np.uint8)
        how = np.array(
            [
                math.log1p(limits.area),
                math.log1p(limits.inertia),
                limits.worse,
                limits.margin_mm,
                math.radians(limits.same_deg),
                limits.floor_mm,
                CLOSE * limits.floor_mm,
            ]
        )
        scratch = np.empty(len(slots) * (4 + 6 * MAX_ROTATIONS))
        room = 2 * len(blobs) + 16
        while True:
            found = np.empty((room, 6))
            count = int(
                self._match(
                    *(
                        len(blobs),
                        *(at(part) for part in mine),
                        len(slots),
                        *(at(part) for part in theirs),
                    ),
                    *(
                        at(normals),
                        at(distances),
                        at(symmetries),
                        None if pairs is None else at(pairs),
                    ),
                    *(at(how), at(self._roots), at(scratch), room, at(found)),
                )
            )
            if count <= room:
                return [Candidate(int(blob), int(slot), *place) for blob, slot, *place in found[:count].tolist()]
            room = count

    def map_locally(self, plane: PlaneView, centre: Points, size: Floats) -> LocalMaps:
        """See `local_map.map_locally`; to 1e-3 px, where the plane has a table."""
        table = plane.forward
        if table is None or not table.holds(centre, size):
            return map_locally(plane, centre, size)
        rows, columns, _ = table.pixels.shape
        nodes, inverse = nodes_of_maps()
        centre, size, maps = plain(centre), plain(size), np.empty((len(centre), MAP_FIELDS))
        self._maps(
            *(at(table.pixels), rows, columns, table.x_mm, table.y_mm, table.pitch_mm),
            *(
                len(nodes),
                at(nodes),
                at(inverse),
                len(centre),
                at(centre),
                at(size),
                at(maps),
            ),
        )
        return LocalMaps(maps)

    def to_pixels(self, plane: PlaneView, points: Points) -> Points:
        """See `plane.PlaneView.to_pixels`; to 1e-3 px, where the plane has a table."""
        table = plane.forward
        if table is None or not table.holds(points, 0.0):
            return plane.to_pixels(points)
        rows, columns, _ = table.pixels.shape
        points, found = plain(points), np.empty((len(points), 2))
        self._to_pixels(
            *(at(table.pixels), rows, columns, table.x_mm, table.y_mm, table.pitch_mm),
            *(len(points), at(points), at(found)),
        )
        return found

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """See `edge_projection.project`."""
        pieces = len(outlines.pieces)
        lines, extras = np.empty((pieces, LINE_FIELDS)), np.empty((pieces, EXTRA_FIELDS))
        starts, table = plain(outlines.starts, np.int64), plain(outlines.pieces)
        placed, mapped = of_poses(poses), plain(maps.table)
        self._project(
            *(len(outlines), at(starts), at(table), at(placed), at(mapped)),
            *(int(mirrored), at(lines), at(extras)),
        )
        return ProjectedEdges(EdgeLines(lines), extras)

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """See `edge_profile.measure_edges`."""
        picture, table, parameters = np.ascontiguousarray(grey), plain(lines.table), of_model(model)
        height, width = picture.shape
        results = np.empty((len(lines), RESULT_FIELDS))
        self._measure[picture.dtype.itemsize](
            *(at(picture), width, width, height, len(lines), at(table)),
            *(at(parameters), at(self._table), at(results)),
        )
        return shifts(results)

    def solve(self, measured: Measured, prior: float) -> Solution:
        """See `pose_solver.solve`."""
        count = len(measured.starts) - 1
        given = np.ascontiguousarray(np.column_stack([measured.distance, measured.sigma, measured.valid]), np.float64)
        starts, extras = plain(measured.starts, np.int64), plain(measured.extras)
        change, covariance = np.empty((count, UNKNOWNS)), np.empty((count, UNKNOWNS, UNKNOWNS))
        spread, remains = np.empty(count), np.empty(len(given))
        self._solve(
            *(count, at(starts), at(extras), at(given), prior),
            *(at(change), at(covariance), at(spread), at(remains)),
        )
        return Solution(change, covariance, spread, remains)

    def split(self, surveyed: Survey) -> Split | None:
        """See `thresholds.split_in_two`."""
        counts = plain(surveyed.grey, np.int64)
        found = np.empty(4)
        return Split.of(*found.tolist()) if self._split(at(counts), at(self._logarithms), at(found)) else None

    def register(
        self, grey: Grey, plane: PlaneView, outlines: OutlineSet, candidates: Sequence[Candidate], *, rough: bool
    ) -> list[Registration]:
        """See `registration.register`."""
        if not candidates:
            return []
        picture = np.ascontiguousarray(grey)
        height, width = picture.shape
        count, scale = len(candidates), plane.mm_per_px
        slots = np.array([candidate.slot for candidate in candidates], np.int64)
        motions = np.array([candidate[2:5] for candidate in candidates])
        pieces = int(outlines.counts[slots].sum())
        unit = np.exp(1j * motions[:, 0]) * outlines.pivots[slots].view(np.complex128)[:, 0]
        position = motions[:, 1:] + np.column_stack([unit.real, unit.imag])
        maps = self.map_locally(plane, position, outlines.reaches_mm[slots] + MARGIN_PX * scale)
        key = (scale, plane.mirrored, rough)
        how = _settings(*key)
        kinds = [
            at(part) for item in (outlines.whole, outlines.few, outlines.probes) for part in (item.starts, item.pieces)
        ]
        starts = np.empty(2 * count + 2, np.int64)
        scratch = self._room(count * REGISTER_OUTLINE + pieces * REGISTER_PIECE)
        found = np.empty((count, FOUND_FIELDS))
        self._register(
            *(
                at(picture),
                width,
                width,
                height,
                int(picture.dtype.itemsize == 2),
                at(self._table),
                at(how),
            ),
            *(
                *kinds,
                at(outlines.pivots),
                at(outlines.reaches_mm),
                count,
                at(slots),
                at(motions),
            ),
            *(at(maps.table), MAP_FIELDS, pieces, at(starts), at(scratch), at(found)),
        )
        return registrations_of(candidates, found[:, :7], found[:, 7:].reshape(count, 3, 3))


@lru_cache(maxsize=16)
def _settings(scale: float, mirrored: bool, rough: bool) -> Floats:  # noqa: FBT001 - the key of a cache
    """Return what the kernel's registration goes by, in the order of its structure."""
    return np.array(
        [
            *(scale, float(mirrored), float(rough)),
            *(FLOOR_PX, PRIOR_SHARE / scale**2, SUPPORT_PX * scale, MISSING_PX * scale, AGAIN_PX * scale),
            WALL_FLOOR_PX * scale,
            *(SIGMA_PX, FIRST_REACH_PX, REACH_PX, WALL_RATIO, WALL_RATIO_SIGMA, FIRST_WALL_RATIO_SIGMA),
            *(*WALL_RATIO_RANGE, LIGHT_SIGMA, NOISE_SHARE, LEAST_NOISE),
        ]
    )


def _load(path: Path | None) -> ctypes.CDLL:
    """Return the library at a path, or the fastest that this processor can run."""
    library = ctypes.CDLL(str(path or LIBRARY))
    version = library.slabcell_kernel_version()
    if version != VERSION:
        msg = f"{path or LIBRARY} is version {version} of the kernel, this is {VERSION}: install slabcell again"
        raise ValueError(msg)
    if path is None and FAST_LIBRARY.exists() and library.slabcell_cpu_level() >= FAST_LEVEL:
        return _load(FAST_LIBRARY)
    return library
