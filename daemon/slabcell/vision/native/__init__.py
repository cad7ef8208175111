"""How is the compiled kernel called?  Through ctypes, with arrays whose memory belongs to the caller.

The C sources lie beside this file.  They are compiled twice where the compiler can: for every processor of the kind,
and for x86-64-v3 (AVX2 and FMA), which is taken where the processor has that.
"""

import threading
from collections.abc import Sequence
from functools import lru_cache
from itertools import accumulate
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError
from slabcell.geometry import Points
from slabcell.vision.contours import Contours
from slabcell.vision.edge_profile import EdgeLines, EdgeShifts, ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses, ProjectedEdges
from slabcell.vision.local_map import MARGIN_PX, LocalMaps, map_locally, nodes_of_maps
from slabcell.vision.matching import FINE, MAX_ROTATIONS, Candidate, MatchLimits
from slabcell.vision.native.library import FAST_LIBRARY, LIBRARY, Functions, load
from slabcell.vision.native.memory import (
    at,
    normal_distribution,
    of_forward,
    of_limits,
    of_model,
    of_outlines,
    of_poses,
    of_shapes,
    of_slot_table,
    of_slots,
    plain,
    shifts,
)
from slabcell.vision.outline import Rings
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.part_poses import PartPoses, SlotTable, part_poses
from slabcell.vision.picture_model import (
    FIRST_REACH_PX,
    FIRST_WALL_RATIO_SIGMA,
    LEAST_NOISE,
    LEAST_SLOPE_SHARE,
    LEAST_SLOPE_SIGMA,
    LIGHT_SIGMA,
    NEAR_REACH_PX,
    NOISE_SHARE,
    REACH_BLURS,
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
from slabcell.vision.shapes import ENOUGH, HARMONICS, SAMPLES, Shapes, Spectra
from slabcell.vision.survey import Survey, step_of
from slabcell.vision.thresholds import LOGARITHMS, Split
from slabcell.vision.walls import FACING, MIN_WALL_PX, WALL_SAMPLES, strip_walls

__all__ = ["FAST_LIBRARY", "LIBRARY", "NativeEngine"]

LINE_FIELDS, RESULT_FIELDS, EXTRA_FIELDS, MAP_FIELDS, FOUND_FIELDS = 7, 14, 8, 63, 16
CANDIDATE_FIELDS, PART_FIELDS = 6, 13
# Numbers that a registration has to remember of each candidate, and of each of its pieces.
REGISTER_OUTLINE, REGISTER_PIECE = 256, 48
# Rooms that are tried first: points of outlines, and outlines.
POINTS, OUTLINES = 1 << 16, 2048
# Outlines of more points than this are noise.
MAX_POINTS: Final = 1 << 24

Floats = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Picture = npt.NDArray[np.uint8]


class NativeEngine:
    """The compiled kernel.  Raises OSError or AttributeError where it is missing, ValueError for another version."""

    name = "native"

    def __init__(self, path: Path | None = None) -> None:
        self._library = load(path)
        self._kernel = Functions(self._library)
        self.level = self._kernel.level
        self._rooms = threading.local()
        self._normal = plain(normal_distribution())
        self._logarithms = plain(LOGARITHMS)
        self._roots = plain(np.exp(-2j * np.pi * np.arange(FINE // 2) / FINE), np.complex128)
        self._nodes, self._inverse = (plain(part) for part in nodes_of_maps())
        self._normal_at, self._logarithms_at, self._roots_at = map(at, (self._normal, self._logarithms, self._roots))
        self._nodes_at = (len(self._nodes), at(self._nodes), at(self._inverse))

    def survey(self, picture: Picture) -> Survey:
        """See `survey.survey`."""
        height, width = picture.shape
        step = step_of(picture)
        counts, found = np.empty((2, 256), np.int64), np.empty(8)
        steepest = self._room(height // (8 * step) + 8)
        into = at(counts)
        self._kernel.survey(
            *(at(picture), width, width, height, step, self._logarithms_at),
            *(at(steepest), into, into + counts.itemsize * 256, at(found)),
        )
        noise, sharpest, lightest, is_split, *split = found.tolist()
        return Survey(
            *(counts[0], counts[1], noise, None if sharpest < 0.0 else sharpest, int(lightest)),
            Split.of(*split) if is_split else None,
        )

    def trace(
        self, picture: Picture, level: float, *, dark: bool, interpolate: bool, min_area_px: float, row_shift: int = 0
    ) -> Contours:
        """See `contours.trace`.  Raises ImageError for outlines of more than MAX_POINTS points."""
        height, width = picture.shape
        points_room, outlines_room = POINTS, OUTLINES
        scratch = self._room(((height >> row_shift) + 1) * ((width + 63) // 64))
        while True:
            points, starts = np.empty((points_room, 2)), np.empty(outlines_room + 1, np.int64)
            areas, rims = np.empty(outlines_room), np.empty(outlines_room, np.uint8)
            totals = np.empty(2, np.int64)
            count = int(
                self._kernel.trace(
                    *(at(picture), width, width, height),
                    *(level, int(dark), int(interpolate), min_area_px, row_shift),
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
        self._kernel.to_plane(at(table.mm), rows, columns, table.pitch_px, len(pixels), at(pixels), at(found))
        return found

    def strip_walls(self, plane: PlaneView, seen: Rings) -> Rings:
        """See `walls.strip_walls`; shifts to 1e-3 px, where the plane has a table."""
        if plane.forward is not None and len(seen):
            rows, columns, _ = plane.grid.mm.shape
            points, starts = plain(seen.points), plain(seen.starts, np.int64)
            scratch = self._room(3 * int(np.diff(starts).max()) + 2 * WALL_SAMPLES)
            found = np.empty((len(seen) * WALL_SAMPLES, 2))
            if self._kernel.strip_walls(
                *(at(plane.grid.mm), rows, columns, plane.grid.pitch_px, *of_forward(plane.forward).addresses),
                *(len(seen), at(starts), at(points), WALL_SAMPLES, MIN_WALL_PX * plane.mm_per_px, FACING),
                *(at(scratch), at(found)),
            ):
                return Rings(found, np.arange(len(seen) + 1) * WALL_SAMPLES)
        return strip_walls(plane, seen)

    def describe(self, rings: Rings) -> Shapes:
        """See `shapes.describe`."""
        starts = plain(rings.starts, np.int64)
        return self._shapes(plain(rings.points), starts[:-1], starts[1:], None)

    def describe_pixels(self, table: PixelTable, pixels: Points, begins: Index, ends: Index) -> Shapes:
        """See `shapes.describe_pixels`."""
        return self._shapes(plain(pixels), plain(begins, np.int64), plain(ends, np.int64), table)

    def _shapes(self, points: Points, begins: Index, ends: Index, table: PixelTable | None) -> Shapes:
        count = len(begins)
        longest = int((ends - begins).max()) if count else 0
        if table is None:
            where, enough = (None, 0, 0, 1.0), max(longest, 1)
        else:
            rows, columns, _ = table.mm.shape
            where, enough = (at(table.mm), rows, columns, table.pitch_px), ENOUGH
        scratch = self._room(4 * longest)
        # All in one piece of memory: samples and spectra, then magnitudes, middle, area, inertia, centroid and energy.
        columns_of = (2 * SAMPLES, 2 * SAMPLES, HARMONICS, 2, 1, 1, 2, 1)
        memory = np.empty(count * sum(columns_of))
        parts: list[Floats] = []
        places: list[int] = []
        begin, base = 0, at(memory)
        for width in columns_of:
            parts.append(memory[begin : begin + count * width])
            places.append(base + memory.itemsize * begin)
            begin += count * width
        samples, values, magnitudes, middle, area, inertia, centroid, energy = parts
        self._kernel.describe(
            *(*where, count, at(begins), at(ends), at(points), enough, SAMPLES, at(scratch)),
            *(places[0], places[3], places[4], places[5], places[6]),
            *(self._roots_at, places[1], places[7], places[2]),
        )
        spectra = Spectra(
            values.view(np.complex128).reshape(count, SAMPLES), energy, magnitudes.reshape(count, HARMONICS)
        )
        return Shapes(
            samples.view(np.complex128).reshape(count, SAMPLES),
            *(middle.view(np.complex128), area, inertia, centroid.reshape(count, 2), spectra),
        )

    def find_candidates(
        self, blobs: Shapes, slots: Shapes, limits: MatchLimits, allowed: npt.NDArray[np.bool_] | None = None
    ) -> list[Candidate]:
        """See `matching.find_candidates`."""
        if len(blobs) == 0 or len(slots) == 0:
            return []
        mine = of_shapes(blobs)
        (*theirs, normals), (distances, orders, how) = of_slots(slots).addresses, of_limits(limits).addresses
        pairs = None if allowed is None else plain(allowed, np.uint8)
        scratch = self._room(len(slots) * (4 + 6 * MAX_ROTATIONS))
        room = 2 * len(blobs) + 16
        while True:
            found = np.empty((room, CANDIDATE_FIELDS))
            count = int(
                self._kernel.match(
                    *(len(blobs), *(at(part) for part in mine), len(slots), *theirs, normals, distances, orders),
                    *(None if pairs is None else at(pairs), how, self._roots_at, at(scratch), room, at(found)),
                )
            )
            if count <= room:
                return [Candidate(int(blob), int(slot), *place) for blob, slot, *place in found[:count].tolist()]
            room = count

    def map_locally(self, plane: PlaneView, centre: Points, size: Floats) -> LocalMaps:
        """See `local_map.map_locally`; to 1e-3 px, where the plane has a table."""
        if plane.forward is not None:
            centre, size, maps = plain(centre), plain(size), np.empty((len(centre), MAP_FIELDS))
            table = of_forward(plane.forward).addresses
            if self._kernel.local_maps(*table, *self._nodes_at, len(centre), at(centre), at(size), at(maps)):
                return LocalMaps(maps)
        return map_locally(plane, centre, size)

    def to_pixels(self, plane: PlaneView, points: Points) -> Points:
        """See `plane.PlaneView.to_pixels`; to 1e-3 px, where the plane has a table."""
        if plane.forward is not None:
            points, found = plain(points), np.empty((len(points), 2))
            if self._kernel.to_pixels(*of_forward(plane.forward).addresses, len(points), at(points), at(found)):
                return found
        return plane.to_pixels(points)

    def project(self, outlines: Outlines, maps: LocalMaps, poses: Poses, *, mirrored: bool) -> ProjectedEdges:
        """See `edge_projection.project`."""
        pieces = len(outlines.pieces)
        lines, extras = np.empty((pieces, LINE_FIELDS)), np.empty((pieces, EXTRA_FIELDS))
        starts, table = plain(outlines.starts, np.int64), plain(outlines.pieces)
        placed, mapped = of_poses(poses), plain(maps.table)
        self._kernel.project(
            *(len(outlines), at(starts), at(table), at(placed), at(mapped)),
            *(int(mirrored), at(lines), at(extras)),
        )
        return ProjectedEdges(EdgeLines(lines), extras)

    def measure_edges(self, grey: Grey, lines: EdgeLines, model: ProfileModel) -> EdgeShifts:
        """See `edge_profile.measure_edges`."""
        picture, table, parameters = np.ascontiguousarray(grey), plain(lines.table), of_model(model)
        height, width = picture.shape
        results = np.empty((len(lines), RESULT_FIELDS))
        self._kernel.measure[picture.dtype.itemsize](
            *(at(picture), width, width, height, len(lines), at(table)),
            *(at(parameters), self._normal_at, at(results)),
        )
        return shifts(results)

    def solve(self, measured: Measured, prior: float) -> Solution:
        """See `pose_solver.solve`."""
        count = len(measured.starts) - 1
        given = np.ascontiguousarray(np.column_stack([measured.distance, measured.sigma, measured.valid]), np.float64)
        starts, extras = plain(measured.starts, np.int64), plain(measured.extras)
        change, covariance = np.empty((count, UNKNOWNS)), np.empty((count, UNKNOWNS, UNKNOWNS))
        spread, remains = np.empty(count), np.empty(len(given))
        self._kernel.solve(
            *(count, at(starts), at(extras), at(given), prior),
            *(at(change), at(covariance), at(spread), at(remains)),
        )
        return Solution(change, covariance, spread, remains)

    def register(
        self, grey: Grey, plane: PlaneView, outlines: OutlineSet, candidates: Sequence[Candidate], *, rough: bool
    ) -> list[Registration]:
        """See `registration.register`."""
        if not candidates:
            return []
        picture = np.ascontiguousarray(grey)
        height, width = picture.shape
        count, scale = len(candidates), plane.mm_per_px
        given, counts = np.array(candidates, np.float64), outlines.counts.tolist()
        pieces = sum(counts[candidate.slot] for candidate in candidates)
        how = _settings(scale, plane.mirrored, rough)
        starts, found = np.empty(3 * count + 2, np.int64), np.empty((count, FOUND_FIELDS))
        scratch = self._room(count * REGISTER_OUTLINE + pieces * REGISTER_PIECE)
        maps: Floats | None = None
        if plane.forward is None:
            maps = self._maps_of(plane, outlines, candidates)
        while True:
            table = (0,) if plane.forward is None else of_forward(plane.forward).addresses
            done = self._kernel.register(
                *(at(picture), width, width, height, int(picture.dtype.itemsize == 2), self._normal_at, at(how)),
                *(*of_outlines(outlines).addresses, *table, *self._nodes_at, None if maps is None else at(maps)),
                *(count, at(given), pieces, at(starts), at(scratch), at(found)),
            )
            if done:
                return registrations_of(candidates, found)
            maps = self._maps_of(plane, outlines, candidates)

    def _maps_of(self, plane: PlaneView, outlines: OutlineSet, candidates: Sequence[Candidate]) -> Floats:
        """Return the maps of candidates by the full model of the camera."""
        slots = [candidate.slot for candidate in candidates]
        position = [item.motion.apply(outlines.pivots[item.slot]) for item in candidates]
        return plain(
            map_locally(plane, np.array(position), outlines.reaches_mm[slots] + MARGIN_PX * plane.mm_per_px).table
        )

    def part_poses(self, plane: PlaneView, slots: SlotTable, chosen: Sequence[Registration]) -> PartPoses:
        """See `part_poses.part_poses`; outlines to 1e-3 px, where the plane has a table."""
        if plane.forward is None or not chosen:
            return part_poses(plane, slots, chosen)
        count = len(chosen)
        which = [item.candidate.slot for item in chosen]
        begins = slots.starts.tolist()
        ends = list(accumulate(begins[slot + 1] - begins[slot] for slot in which))
        given = np.array([(item.rotation, item.x_mm, item.y_mm, *item.covariance) for item in chosen])
        numbers, pixels = np.empty((count, PART_FIELDS)), np.empty((ends[-1], 2))
        places = np.array(which, np.int64)
        if not self._kernel.poses(
            *(*of_forward(plane.forward).addresses, plane.mm_per_px, count, at(places), at(given)),
            *(*of_slot_table(slots).addresses, at(numbers), at(pixels)),
        ):
            return part_poses(plane, slots, chosen)
        return PartPoses(numbers.tolist(), [pixels[begin:end] for begin, end in zip([0, *ends], ends, strict=False)])


@lru_cache(maxsize=16)
def _settings(scale: float, mirrored: bool, rough: bool) -> Floats:  # noqa: FBT001 - the key of a cache
    """Return what the kernel's registration goes by, in the order of its structure."""
    return np.array(
        [
            *(scale, float(mirrored), float(rough)),
            *(FLOOR_PX, PRIOR_SHARE / scale**2, SUPPORT_PX * scale, MISSING_PX * scale, AGAIN_PX * scale),
            *(WALL_FLOOR_PX * scale, MARGIN_PX * scale),
            *(SIGMA_PX, FIRST_REACH_PX, REACH_PX, WALL_RATIO, WALL_RATIO_SIGMA, FIRST_WALL_RATIO_SIGMA),
            *(*WALL_RATIO_RANGE, LIGHT_SIGMA, NOISE_SHARE, LEAST_NOISE),
            *(LEAST_SLOPE_SIGMA, LEAST_SLOPE_SHARE, NEAR_REACH_PX, REACH_BLURS),
        ]
    )
