"""How do slabs lie in their slots?  Measures what was laid, slot by slot, against the template.

Slabs that were laid touch each other, so there are no blobs to find: every slot is looked at where its slab should be.
Free edges are registered as when picking.  Between two slabs the joint's dark line gives the middle between both edges,
which ties their poses together; all slots are solved for at once.  What edges and joints do not determine is said to be
not measurable.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from slabcell.calibration.model import Calibration
from slabcell.geometry import RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.vision.edge_profile import ProfileModel
from slabcell.vision.edge_projection import Outlines, Poses, ProjectedEdges
from slabcell.vision.kernel import engine, maps_of
from slabcell.vision.locate import Locator
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.picture_model import SIGMA_PX, WALL_RATIO
from slabcell.vision.pixels import Grey, as_grey
from slabcell.vision.seams import measure_seams
from slabcell.vision.segmentation import segment

__all__ = ["SlotPlacement", "measure_placement", "measure_slots"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.uint8]

# Share of a slot that must be covered for a slab to lie in it.
MIN_COVERED = 0.85
# How far from its slot a slab is looked for.
REACH_PX = 9.0
JOINT_REACH_PX = 6.0
# Known beforehand: a slab that was laid lies within about this of its slot.
PRIOR_MM = 2.0
PRIOR_DEG = 2.0
PRIOR_KERF_MM = 1.0
# A slot across an edge is one that holds the point this far outside of it.
ACROSS_MM = 1.0
# Outside of a free edge, at these distances beyond the wall, there is only table.
FREE_PX = (5.0, 8.0)
# A slot counts as measured when position and rotation are known this well.
MAX_SIGMA_MM = 0.15
MAX_SIGMA_DEG = 0.15
FLOOR_PX = 0.03
JOINT_FLOOR_PX = 0.1
# How well the light that a joint takes away tells its width: slabs that touch cast a shadow into the joint too.
GAP_SIGMA_MM = 0.15
GAP_SIGMA_SHARE = 0.3
ROUNDS = 3
ROBUST_STEPS = 5
TUKEY = 4.7


@dataclass(frozen=True, slots=True)
class SlotPlacement:
    """What lies in one slot.

    ``found``: a slab covers the slot.  ``dx_mm``, ``dy_mm``, ``da_deg``: placed minus nominal in the assembly frame, of
    the slot's middle; NaN unless ``measured``, which says that edges and joints determine them.  ``residual_mm``: RMS
    distance of the measured edges from the fit.  ``covered``: share of the slot that is covered.  ``sigma_mm``: the
    larger standard deviation of dx and dy.
    """

    slot: int
    found: bool
    dx_mm: float
    dy_mm: float
    da_deg: float
    residual_mm: float
    detail: str = ""
    measured: bool = False
    covered: float = 0.0
    sigma_mm: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """``rows`` (n, 3·slots + 1) times the unknown motions and the kerf is ``distance`` (mm), known to ``sigma``.

    ``owner``: index of the slot whose piece of edge it is, -1 for a gap.
    """

    rows: Floats
    distance: Floats
    sigma: Floats
    owner: npt.NDArray[np.intp]

    def joined(self, other: "_Equations") -> "_Equations":
        """Return these equations and the others."""
        return _Equations(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.distance, other.distance]),
            np.concatenate([self.sigma, other.sigma]),
            np.concatenate([self.owner, other.owner]),
        )


def measure_placement(
    image: npt.NDArray[Any],
    calibration: Calibration,
    recipe: Recipe,
    *,
    assembly_in_table: RigidTransform2D,
    slots: Collection[int],
) -> tuple[SlotPlacement, ...]:
    """Return what lies in each of these slots, in their order by number.

    ``assembly_in_table``: table = motion·assembly.  Raises CalibrationError and ImageError as `locate` does.
    """
    return measure_slots(Locator(calibration, recipe), image, assembly_in_table=assembly_in_table, slots=slots)


def measure_slots(
    locator: Locator, image: npt.NDArray[Any], *, assembly_in_table: RigidTransform2D, slots: Collection[int]
) -> tuple[SlotPlacement, ...]:
    """Return what `measure_placement` returns, with a Locator that is at hand."""
    grey = as_grey(image)
    locator.calibration.require_size(grey.shape[1], grey.shape[0], "the picture")
    mask = segment(grey, locator.recipe.segmentation, image).mask
    asked = sorted(set(slots))
    covered = {slot: _covered(mask, locator, slot, assembly_in_table) for slot in asked}
    # Slots that nobody asked for may be filled too, and their slabs end the edges of their neighbours.
    filled = [slot for slot in asked if covered[slot] >= MIN_COVERED and len(locator.pieces[slot])]
    measured = _measure(grey, mask, locator, filled, assembly_in_table)
    result: list[SlotPlacement] = []
    for slot in asked:
        share = covered[slot]
        if slot in measured:
            result.append(measured[slot].placement(share))
        elif share >= MIN_COVERED:
            detail = "covered, but it has no edge that could be measured"
            result.append(_unknown(slot, share, detail, found=True))
        else:
            detail = f"{100 * share:.0f} % of the slot is covered, {100 * MIN_COVERED:.0f} % are needed"
            result.append(_unknown(slot, share, detail, found=False))
    return tuple(result)


def _covered(mask: Mask, locator: Locator, slot: int, assembly_in_table: RigidTransform2D) -> float:
    """Return which share of a slot, without a strip at its rim, is foreground; what is out of view is not."""
    inner = locator.slots[slot].shape.buffer(-3.0 * locator.plane.mm_per_px)
    if inner.is_empty:
        inner = locator.slots[slot].shape
    rings = getattr(inner, "geoms", [inner])
    total = hit = 0
    for ring in rings:
        outline = np.asarray(ring.exterior.coords, np.float64)[:-1]
        pixels = locator.plane.to_pixels(assembly_in_table.apply(outline))
        low = np.floor(pixels.min(axis=0)).astype(int)
        size = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) - low + 1, 30_000)
        area = np.zeros((int(size[1]), int(size[0])), np.uint8)
        cv2.fillPoly(area, [np.rint(pixels - low).astype(np.int32)], 255)
        total += int(np.count_nonzero(area))
        u, v = int(low[0]), int(low[1])
        left, top = max(u, 0), max(v, 0)
        right, bottom = min(u + area.shape[1], mask.shape[1]), min(v + area.shape[0], mask.shape[0])
        if right > left and bottom > top:
            seen = mask[top:bottom, left:right] > 0
            hit += int(np.count_nonzero(seen & (area[top - v : bottom - v, left - u : right - u] > 0)))
    return hit / total if total else 0.0


def _measure(
    grey: Grey, mask: Mask, locator: Locator, filled: Sequence[int], assembly_in_table: RigidTransform2D
) -> dict[int, "_Measured"]:
    """Return the placement of the filled slots that have edges.  All unknowns count from the nominal poses."""
    if not filled:
        return {}
    count = len(filled)
    pivots = np.array([locator.slots[slot].centroid for slot in filled])
    nominal = Poses(
        np.full(count, np.deg2rad(assembly_in_table.rotation_deg)),
        assembly_in_table.apply(pivots),
        pivots,
        np.zeros(count),
    )
    outlines = [locator.pieces[slot] for slot in filled]
    together, mirrored = Outlines.of(outlines), locator.plane.mirrored
    maps, owner = maps_of(locator.plane, OutlineSet(tuple(outlines), pivots), nominal.position), together.owner
    edges = engine().project(together, maps, nominal, mirrored=mirrored)
    neighbour = _neighbours(locator, filled)
    joints = _joints(grey, edges, owner, nominal, neighbour, _table_level(grey, mask))
    free = (neighbour < 0) & _is_free(mask, edges)
    # Prior knowledge keeps what nothing measures at its nominal place, with an honest uncertainty.
    known = np.append(np.tile([PRIOR_MM, PRIOR_MM, np.deg2rad(PRIOR_DEG)], count), PRIOR_KERF_MM)
    unknown = np.zeros(3 * count + 1)
    covariance = np.diag(known**2)
    equations, remaining = joints, np.zeros(0)
    for _ in range(ROUNDS):
        change = unknown[:-1].reshape(-1, 3)
        poses = Poses(
            nominal.rotation + change[:, 2],
            nominal.position + change[:, :2],
            pivots,
            np.full(count, unknown[-1]),
        )
        edges = engine().project(together, maps, poses, mirrored=mirrored)
        equations = joints.joined(_free_edges(grey, edges, owner, free, unknown))
        unknown, covariance, remaining = _solve(equations, known)
    back = assembly_in_table.inverse().matrix
    result: dict[int, _Measured] = {}
    for index, slot in enumerate(filled):
        own = covariance[3 * index : 3 * index + 3, 3 * index : 3 * index + 3]
        dx, dy = back @ unknown[3 * index : 3 * index + 2]
        mine = remaining[equations.owner == index]
        result[slot] = _Measured(
            slot,
            float(dx),
            float(dy),
            float(np.rad2deg(unknown[3 * index + 2])),
            float(np.sqrt(np.mean(np.minimum(mine**2, 1.0)))) if len(mine) else float("nan"),
            float(np.sqrt(max(own[0, 0], own[1, 1]))),
            float(np.rad2deg(np.sqrt(own[2, 2]))),
        )
    return result


@dataclass(frozen=True, slots=True)
class _Measured:
    slot: int
    dx_mm: float
    dy_mm: float
    da_deg: float
    residual_mm: float
    sigma_mm: float
    sigma_deg: float

    def placement(self, covered: float) -> SlotPlacement:
        """Return the values, or that they are not measurable."""
        if self.sigma_mm > MAX_SIGMA_MM or self.sigma_deg > MAX_SIGMA_DEG:
            detail = (
                f"covered, but its free edges and joints leave {self.sigma_mm:.2f} mm and {self.sigma_deg:.2f}° open:"
                " not measurable"
            )
            return _unknown(self.slot, covered, detail, found=True)
        return SlotPlacement(
            slot=self.slot,
            found=True,
            dx_mm=self.dx_mm,
            dy_mm=self.dy_mm,
            da_deg=self.da_deg,
            residual_mm=self.residual_mm,
            measured=True,
            covered=covered,
            sigma_mm=self.sigma_mm,
        )


def _unknown(slot: int, covered: float, detail: str, *, found: bool) -> SlotPlacement:
    nothing = float("nan")
    return SlotPlacement(slot, found, nothing, nothing, nothing, nothing, detail, covered=covered)


def _neighbours(locator: Locator, filled: Sequence[int]) -> npt.NDArray[np.intp]:
    """Return for each piece the index in ``filled`` of the slot across the edge, or -1."""
    result: list[npt.NDArray[np.intp]] = []
    for slot in filled:
        pieces = locator.pieces[slot]
        across = pieces.middle + ACROSS_MM * pieces.outward
        found = np.full(len(pieces), -1, np.intp)
        for index, other in enumerate(filled):
            if other != slot:
                found[shapely.contains_xy(locator.slots[other].shape, across[:, 0], across[:, 1])] = index
        result.append(found)
    return np.concatenate(result)


def _table_level(grey: Grey, mask: Mask) -> float:
    background = grey[::4, ::4][mask[::4, ::4] == 0]
    return float(np.median(background)) if len(background) else 0.0


def _is_free(mask: Mask, edges: ProjectedEdges) -> npt.NDArray[np.bool_]:
    """Return for each piece whether only table is seen outside of it, as far as the profile reaches."""
    free = np.ones(len(edges.lines), np.bool_)
    for distance in FREE_PX:
        place = np.rint(edges.lines.middle + (edges.lines.wall + distance)[:, None] * edges.lines.outward).astype(int)
        inside = (place >= 0).all(axis=1) & (place[:, 0] < mask.shape[1]) & (place[:, 1] < mask.shape[0])
        place[~inside] = 0
        free &= inside & (mask[place[:, 1], place[:, 0]] == 0)
    return free


def _free_edges(
    grey: Grey, edges: ProjectedEdges, owner: npt.NDArray[np.intp], free: npt.NDArray[np.bool_], unknown: Floats
) -> _Equations:
    """Return how far the free edges lie outside of where the current solution expects them, from nominal."""
    at = np.flatnonzero(free)
    found = engine().measure_edges(grey, edges.lines.select(at), ProfileModel(SIGMA_PX, REACH_PX, WALL_RATIO, 0.3))
    at = at[found.valid]
    rows = np.zeros((len(at), len(unknown)))
    number = np.arange(len(at))
    for column in range(3):
        rows[number, 3 * owner[at] + column] = edges.rows[at, column]
    rows[:, -1] = 1.0
    return _Equations(
        rows,
        found.shift[found.valid] / edges.px_per_mm[at] + rows @ unknown,
        np.hypot(found.sigma[found.valid], FLOOR_PX) / edges.px_per_mm[at],
        owner[at],
    )


def _joints(
    grey: Grey,
    edges: ProjectedEdges,
    owner: npt.NDArray[np.intp],
    nominal: Poses,
    neighbour: npt.NDArray[np.intp],
    table: float,
) -> _Equations:
    """Return where joints run, which half of each neighbour's motion moves and kerf does not, and how wide they are."""
    at = np.flatnonzero(neighbour >= 0)
    model = ProfileModel(SIGMA_PX, JOINT_REACH_PX, WALL_RATIO, 0.3)
    seams = measure_seams(grey, edges.lines.select(at), model, table)
    at, valid = at[seams.valid], seams.valid
    count = len(nominal.rotation)
    own, other = owner[at], neighbour[at]
    arm = edges.on_table[at] - nominal.position[other]
    turn = edges.outward[at, 1] * arm[:, 0] - edges.outward[at, 0] * arm[:, 1]
    theirs = np.column_stack([edges.outward[at], turn])
    rows = np.zeros((len(at), 3 * count + 1))
    number = np.arange(len(at))
    for column in range(3):
        rows[number, 3 * own + column] = 0.5 * edges.rows[at, column]
        rows[number, 3 * other + column] = 0.5 * theirs[:, column]
    per_mm = edges.px_per_mm[at]
    middle = _Equations(rows, seams.shift[valid] / per_mm, np.hypot(seams.sigma[valid], JOINT_FLOOR_PX) / per_mm, own)
    # The width of the gap is known less well, and not better from many pieces of one joint than from one.
    apart = rows.copy()
    for column in range(3):
        apart[number, 3 * own + column] = -edges.rows[at, column]
        apart[number, 3 * other + column] = theirs[:, column]
    apart[:, -1] = -2.0
    gap = seams.gap[valid] / per_mm
    joint = own * count + other
    repeats = np.bincount(joint, minlength=1)[joint] if len(joint) else np.zeros(0)
    sigma = np.hypot(GAP_SIGMA_MM, GAP_SIGMA_SHARE * gap) * np.sqrt(2.0 * repeats)
    return middle.joined(_Equations(apart, gap, sigma, np.full(len(at), -1)))


def _solve(equations: _Equations, known: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the unknowns, their covariance and what remains of each equation; robust against single wrong pieces."""
    rows, sigma = equations.rows, equations.sigma
    robust = np.ones(len(sigma))
    prior = np.diag(1.0 / known**2)
    unknown = np.zeros(len(known))
    normal = prior
    remaining = equations.distance
    spread = 1.0
    for _ in range(ROBUST_STEPS):
        weight = robust / sigma**2
        normal = rows.T @ (weight[:, None] * rows) + prior
        unknown = np.linalg.solve(normal, rows.T @ (weight * equations.distance)).astype(np.float64, copy=False)
        remaining = equations.distance - rows @ unknown
        scaled = np.abs(remaining) / sigma
        spread = max(1.0, float(np.median(scaled)) / 0.6745) if len(scaled) else 1.0
        robust = np.maximum(1.0 - (scaled / (TUKEY * spread)) ** 2, 0.0) ** 2
    covariance: Floats = np.linalg.inv(normal).astype(np.float64, copy=False) * spread**2
    return unknown, covariance, remaining
