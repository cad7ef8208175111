"""Which slabs make up a blob that is larger than every slot?  The ones whose outlines explain it wholly, or none.

An edge of the blob that is as long as an edge of a slot says where that slot's slab would lie.  Each such guess is
checked in the mask: the slab must lie inside of the blob, and a good part of its outline must be the blob's own.  That
part is registered in the raw pixels.  Guesses that pass and do not overlap are taken together only if they fill the
blob; what is explained by half is not picked.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points, Polygon, RigidTransform2D
from slabcell.vision.blobs import RawBlob
from slabcell.vision.edge_projection import Outlines, Poses
from slabcell.vision.edges import EdgePieces
from slabcell.vision.kernel import engine, maps_of
from slabcell.vision.matching import Candidate
from slabcell.vision.outline import Rings
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.pixels import Grey
from slabcell.vision.prepared import Prepared
from slabcell.vision.registration import Registration

__all__ = ["split_blob"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

# Difference of lengths of an edge of the blob and one of the slot.
LENGTH_PX = 5.0
MIN_EDGE_PX = 20.0
MAX_GUESSES = 400
# A guess is about the same as another of its slot within this.
SAME_PX, SAME_DEG = 8.0, 6.0
# Where beside an edge the mask is asked, before and after the registration.
ROUGH_PX, FINE_PX = 5.0, 3.0
# Share of the outline that must lie inside of the blob, before and after, and that must be the blob's own outline.
ROUGH_INSIDE, FINE_INSIDE, MIN_FREE = 0.85, 0.95, 0.3
# Share of two slabs' area that may overlap, and how well the slabs together must fill the blob.
MAX_OVERLAP, MAX_UNFILLED = 0.02, 0.03
# Share of a slab's area from which on it lies in the place of another.
SAME_PLACE = 0.8
# What is seen of a slab is only a part of its outline: that part must fit better than a whole one would have to.
MIN_COVERAGE, RESIDUAL_SHARE = 0.98, 0.5
# A part of an outline fits many slots if they may be larger or smaller at will: one saw has cut all slabs of a blob.
KERF_PX = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Guesses:
    """Slots laid at poses: ``slot`` (n,), ``rotation`` (n,) radians, ``position`` (n, 2) of the slot's middle."""

    slot: npt.NDArray[np.intp]
    rotation: Floats
    position: Points

    @property
    def numbers(self) -> list[int]:
        """The slots."""
        return [int(slot) for slot in self.slot]


def split_blob(prepared: Prepared, grey: Grey, mask: Mask, index: int, blob: RawBlob) -> list[list[Registration]]:
    """Return the slabs that make up blob number ``index``, or nothing where they do not explain it.

    Each slab is a list: how it is registered, and then what else could lie in that place, another slot or rotation.
    """
    rings = Rings.of([prepared.plane.from_pixels(blob.polygon)]).counter_clockwise()
    guesses = _guess(rings.points, prepared)
    if len(guesses.slot) == 0:
        return []
    inside, free, _ = _look(prepared, mask, guesses, ROUGH_PX)
    good = (inside >= ROUGH_INSIDE) & (free >= MIN_FREE)
    guesses = _distinct(prepared, _select(guesses, good), (inside + free)[good])
    if len(guesses.slot) == 0:
        return []
    _, _, pieces = _look(prepared, mask, guesses, ROUGH_PX)
    candidates = [
        Candidate(index, number, *_place(prepared, guesses, number), 0.0) for number in range(len(guesses.slot))
    ]
    outlines = OutlineSet.of([prepared.slots[slot] for slot in guesses.numbers], pieces)
    registered = engine().register(grey, prepared.plane, outlines, candidates, rough=True)
    return _explain(prepared, mask, guesses.slot, registered, abs(float(rings.moments[0][0])))


def _guess(outline: Points, prepared: Prepared) -> _Guesses:
    """Return every slot at every edge of the outline that is as long as one of its own."""
    scale = prepared.plane.mm_per_px
    edges = np.roll(outline, -1, axis=0) - outline
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    slots: list[int] = []
    turns: list[float] = []
    places: list[Points] = []
    for number, slot in enumerate(prepared.slots):
        own = np.roll(slot.vertices, -1, axis=0) - slot.vertices
        own_lengths = np.hypot(own[:, 0], own[:, 1])
        fits = np.abs(own_lengths[:, None] - lengths) <= LENGTH_PX * scale
        fits &= (lengths >= MIN_EDGE_PX * scale) & (own_lengths[:, None] >= MIN_EDGE_PX * scale)
        for mine, theirs in np.argwhere(fits).tolist():
            turn = float(np.arctan2(edges[theirs, 1], edges[theirs, 0]) - np.arctan2(own[mine, 1], own[mine, 0]))
            middle = outline[theirs] + 0.5 * edges[theirs]
            arm = slot.centroid - (slot.vertices[mine] + 0.5 * own[mine])
            slots.append(number)
            turns.append(turn)
            places.append(middle + RigidTransform2D(np.rad2deg(turn), 0.0, 0.0).apply(arm))
    if len(slots) > MAX_GUESSES:
        return _Guesses(np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 2)))
    return _Guesses(np.array(slots, np.intp), np.array(turns), np.array(places).reshape(-1, 2))


def _select(guesses: _Guesses, which: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> _Guesses:
    return _Guesses(guesses.slot[which], guesses.rotation[which], guesses.position[which])


def _distinct(prepared: Prepared, guesses: _Guesses, quality: Floats) -> _Guesses:
    """Return the guesses without those that are about the same as a better one."""
    kept: list[int] = []
    for index in np.argsort(-quality):
        same = False
        for other in kept:
            if guesses.slot[index] != guesses.slot[other]:
                continue
            step = 360.0 / prepared.orders[int(guesses.slot[index])]
            turn = float(np.rad2deg(guesses.rotation[index] - guesses.rotation[other])) / step
            near = np.hypot(*(guesses.position[index] - guesses.position[other])) <= SAME_PX * prepared.plane.mm_per_px
            same |= bool(near) and abs(turn - round(turn)) * step <= SAME_DEG
        if not same:
            kept.append(int(index))
    return _select(guesses, np.array(kept, np.intp))


def _look(
    prepared: Prepared, mask: Mask, guesses: _Guesses, distance_px: float
) -> tuple[Floats, Floats, list[EdgePieces]]:
    """Return which share of each guess lies in the mask, which share of its outline ends there, and those pieces."""
    plane = prepared.plane
    whole = [prepared.pieces[slot] for slot in guesses.numbers]
    pivots: Points = np.array([prepared.slots[slot].centroid for slot in guesses.numbers])
    poses = Poses(guesses.rotation, guesses.position, pivots, np.zeros(len(whole)))
    outlines = Outlines.of(whole)
    edges = engine().project(
        outlines, maps_of(plane, OutlineSet(tuple(whole), pivots), guesses.position), poses, mirrored=plane.mirrored
    )
    within = edges.lines.middle - distance_px * edges.lines.outward
    beyond = edges.lines.middle + (edges.lines.wall + distance_px)[:, None] * edges.lines.outward
    inner, outer = _at(mask, within), ~_at(mask, beyond)
    count, owner, share = len(whole), outlines.owner, edges.share
    inside: Floats = np.bincount(owner, np.where(inner, share, 0.0), minlength=count).astype(np.float64, copy=False)
    free: Floats = np.bincount(owner, np.where(outer, share, 0.0), minlength=count).astype(np.float64, copy=False)
    pieces = [
        item.selected(np.flatnonzero(outer[begin:end]))
        for item, begin, end in zip(whole, outlines.starts[:-1], outlines.starts[1:], strict=True)
    ]
    return inside, free, pieces


def _at(mask: Mask, pixels: Points) -> npt.NDArray[np.bool_]:
    whole = np.rint(pixels).astype(np.intp)
    seen = (whole >= 0).all(axis=1) & (whole[:, 0] < mask.shape[1]) & (whole[:, 1] < mask.shape[0])
    whole[~seen] = 0
    return seen & (mask[whole[:, 1], whole[:, 0]] > 0)


def _place(prepared: Prepared, guesses: _Guesses, index: int) -> tuple[float, float, float]:
    """Return rotation (rad), x and y of the motion of a guess: table = motion·assembly."""
    turn = float(guesses.rotation[index])
    pivot = prepared.slots[int(guesses.slot[index])].centroid
    x, y = guesses.position[index] - RigidTransform2D(math.degrees(turn), 0.0, 0.0).apply(pivot)
    return turn, float(x), float(y)


def _explain(
    prepared: Prepared,
    mask: Mask,
    slots: npt.NDArray[np.intp],
    registered: Sequence[Registration],
    area_mm2: float,
) -> list[list[Registration]]:
    """Return the registrations that fill the blob, under their slots' own numbers, each with what else fits there."""
    limits = prepared.recipe.matching
    numbers = [int(slot) for slot in slots]
    pivots = [prepared.slots[slot].centroid for slot in numbers]
    places = [item.motion.apply(pivot) for item, pivot in zip(registered, pivots, strict=True)]
    turns = np.array([item.rotation for item in registered])
    inside, free, _ = _look(prepared, mask, _Guesses(slots, turns, np.array(places)), FINE_PX)
    order = sorted(range(len(registered)), key=lambda index: -registered[index].coverage * free[index])
    order = [index for index in order if inside[index] >= FINE_INSIDE and free[index] >= MIN_FREE]
    chosen: list[list[Registration]] = []
    laid: list[Polygon] = []
    taken: set[int] = set()
    # The one that is seen best comes first, and says what the saw has taken.
    kerf_mm: float | None = None
    for index in order:
        item, slot = registered[index], numbers[index]
        if item.coverage < MIN_COVERAGE or item.residual_mm > RESIDUAL_SHARE * limits.max_residual_mm:
            continue
        if kerf_mm is None:
            kerf_mm = item.kerf_mm
        if abs(item.kerf_mm - kerf_mm) > KERF_PX * prepared.plane.mm_per_px:
            continue
        polygon = prepared.slots[slot].transformed(item.motion)
        own = item._replace(candidate=item.candidate._replace(slot=slot))
        covered = [_overlap(polygon, other) / polygon.area_mm2 for other in laid]
        place = next((number for number, share in enumerate(covered) if share > SAME_PLACE), None)
        if place is not None:
            if all(share <= MAX_OVERLAP for number, share in enumerate(covered) if number != place):
                chosen[place].append(own)
        elif slot not in taken and all(share <= MAX_OVERLAP for share in covered):
            chosen.append([own])
            laid.append(polygon)
            taken.add(slot)
    # The walls that are seen make the blob larger than the faces: by their width, over about half of the outline.
    walls = 0.5 * prepared.widest_wall_px * prepared.plane.mm_per_px * sum(item.perimeter_mm for item in laid) / np.pi
    filled = sum(item.area_mm2 for item in laid)
    explained = (1.0 - MAX_UNFILLED) * area_mm2 - walls <= filled <= (1.0 + MAX_UNFILLED) * area_mm2
    return chosen if len(chosen) > 1 and explained else []


def _overlap(first: Polygon, second: Polygon) -> float:
    common: Any = first.shape.intersection(second.shape)
    return float(common.area)
