"""Where do the slabs lie, and which slot is each for?  The stages in order: segment, blobs, match, register, grasp."""

import math
import time
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely

from slabcell.calibration.model import Calibration
from slabcell.geometry import PlanarPose, Points, Polygon, RigidTransform2D, normalize_deg
from slabcell.recipe import Recipe
from slabcell.vision.blobs import RawBlob, find_blobs
from slabcell.vision.describe import Shapes, describe_blobs, describe_slots, has_visible_walls
from slabcell.vision.edges import EdgePieces, cut_edges
from slabcell.vision.grasp import Grasp, choose_grasp
from slabcell.vision.matching import Candidate, assign, find_candidates
from slabcell.vision.pixels import as_grey
from slabcell.vision.plane import PlaneView
from slabcell.vision.registration import Registration, register
from slabcell.vision.result import ImagePose, LocatedPart, LocateResult, RejectedBlob, RejectionReason, Sigma
from slabcell.vision.segmentation import segment
from slabcell.vision.symmetry import symmetry_order

__all__ = ["Locator", "locate"]

# Rotations count as alike when no corner leaves the outline by more than this, in pixels or in mm, whichever is more.
ALIKE_PX = 0.15
ALIKE_MM = 0.05
# Share of a slab's outline that must be where the fit says.
MIN_COVERAGE = 0.8
# What the whole-outline registration may be off before the edges are measured: in pixels, and in parts of the size.
COARSE_PX = 3.0
COARSE_SHARE = 0.03


def locate(
    image: npt.NDArray[Any],
    calibration: Calibration,
    recipe: Recipe,
    *,
    area_mm: Polygon | None = None,
    free_slots: Collection[int] | None = None,
) -> LocateResult:
    """Return the slabs found in a picture, each with its slot and poses, and everything refused with the reason.

    ``image``: (h, w) or (h, w, 3) blue green red, uint8 or uint16.  ``area_mm``: only blobs whose middle lies in
    this polygon of the table count.  ``free_slots``: only these may be filled; None means all.  Raises
    CalibrationError for a picture of another size than the calibration's, ImageError for an array that is no picture.

    For several pictures of one product make a `Locator` once.
    """
    return Locator(calibration, recipe).locate(image, area_mm=area_mm, free_slots=free_slots)


@dataclass(frozen=True, eq=False)
class Locator:
    """Everything about a calibration and a recipe that does not change from picture to picture."""

    calibration: Calibration
    recipe: Recipe

    @cached_property
    def plane(self) -> PlaneView:
        """The plane of the slabs' upper faces."""
        self.calibration.require_plane()
        return PlaneView(self.calibration, self.recipe.thickness_mm)

    @cached_property
    def slots(self) -> tuple[Polygon, ...]:
        """The slots of the template, assembly frame."""
        return self.recipe.template.slots

    @cached_property
    def shapes(self) -> Shapes:
        """Features of the slots."""
        return describe_slots(self.slots)

    @cached_property
    def pieces(self) -> tuple[EdgePieces, ...]:
        """Measurable pieces of the slots' outlines."""
        return tuple(cut_edges(slot, self.plane.mm_per_px) for slot in self.slots)

    @cached_property
    def orders(self) -> tuple[int, ...]:
        """Rotational symmetry of each slot."""
        tolerance = max(ALIKE_MM, ALIKE_PX * self.plane.mm_per_px)
        return tuple(symmetry_order(slot, tolerance) for slot in self.slots)

    @cached_property
    def grasps(self) -> tuple[Grasp, ...]:
        """Where each slot's slab is grasped, assembly frame."""
        return tuple(choose_grasp(slot, self.recipe.grasp) for slot in self.slots)

    @cached_property
    def walls(self) -> bool:
        """Whether the slabs' walls are seen."""
        return has_visible_walls(self.plane)

    def locate(
        self,
        image: npt.NDArray[Any],
        *,
        area_mm: Polygon | None = None,
        free_slots: Collection[int] | None = None,
    ) -> LocateResult:
        """Return what `locate` returns."""
        clock = _Clock()
        grey = as_grey(image)
        self.calibration.require_size(grey.shape[1], grey.shape[0], "the picture")
        free = set(range(len(self.slots))) if free_slots is None else set(free_slots)
        segmentation = segment(grey, self.recipe.segmentation)
        clock.stop("segment")
        min_area_px = self.recipe.segmentation.min_area_mm2 / self.plane.mm_per_px**2
        blobs, left_out = find_blobs(segmentation.mask, min_area_px)
        if area_mm is not None:
            blobs = self._inside(blobs, area_mm)
        described = describe_blobs(blobs, self.plane, without_walls=self.walls)
        clock.stop("blobs")
        outcome = _Outcome(self, blobs, described, free)
        candidates = outcome.candidates()
        clock.stop("match")
        registrations = register(grey, self.plane, self.slots, self.pieces, candidates)
        clock.stop("register")
        parts, rejected = outcome.decide(candidates, registrations)
        clock.stop("decide")
        filled = {part.slot for part in parts}
        note = f"; {left_out} specks left out" if left_out else ""
        return LocateResult(
            tuple(parts),
            tuple(rejected),
            tuple(sorted(free - filled)),
            clock.times(),
            segmentation.description + note,
        )

    def _inside(self, blobs: list[RawBlob], area_mm: Polygon) -> list[RawBlob]:
        if not blobs:
            return blobs
        middles = self.plane.from_pixels(np.array([blob.polygon.mean(axis=0) for blob in blobs]))
        inside = shapely.contains_xy(area_mm.shape, middles[:, 0], middles[:, 1])
        return [blob for blob, keep in zip(blobs, inside, strict=True) if keep]


class _Clock:
    def __init__(self) -> None:
        self._begin = self._last = time.perf_counter()
        self._times: dict[str, float] = {}

    def stop(self, stage: str) -> None:
        now = time.perf_counter()
        self._times[stage] = 1e3 * (now - self._last)
        self._last = now

    def times(self) -> dict[str, float]:
        return {**self._times, "total": 1e3 * (time.perf_counter() - self._begin)}


class _Outcome:
    """What becomes of each blob of one picture."""

    def __init__(self, locator: Locator, blobs: list[RawBlob], shapes: Shapes, free: set[int]) -> None:
        self._locator = locator
        self._blobs = blobs
        self._shapes = shapes
        self._free = free
        self._refused: dict[int, tuple[RejectionReason, str]] = {}

    def candidates(self) -> list[Candidate]:
        """Return what each blob may be, and refuse those that can be nothing."""
        locator = self._locator
        scale = locator.plane.mm_per_px
        size = np.sqrt(locator.shapes.area_mm2)
        tolerance = locator.recipe.matching.area_tolerance
        found = find_candidates(
            self._shapes,
            locator.shapes,
            area_tolerance=tolerance,
            limit_mm=COARSE_PX * scale + COARSE_SHARE * size + locator.recipe.matching.max_residual_mm,
            margin_mm=0.5 * scale,
            symmetry_order=locator.orders,
        )
        hopeful = {candidate.blob for candidate in found}
        areas = locator.shapes.area_mm2
        for index, blob in enumerate(self._blobs):
            area = float(self._shapes.area_mm2[index])
            if blob.touches_rim and locator.recipe.segmentation.border == "reject":
                self._refused[index] = (RejectionReason.TOUCHES_BORDER, "the rim of the picture cuts it")
            elif index in hopeful:
                continue
            elif area < areas.min() * (1.0 - tolerance):
                self._refused[index] = (
                    RejectionReason.TOO_SMALL,
                    f"{area:.0f} mm², the smallest slot has {areas.min():.0f} mm²",
                )
            elif area > areas.max() * (1.0 + tolerance):
                self._refused[index] = (
                    RejectionReason.TOUCHING,
                    f"{area:.0f} mm², the largest slot has {areas.max():.0f} mm²: slabs that touch, or no slab",
                )
            else:
                self._refused[index] = (
                    RejectionReason.NO_SLOT_FITS,
                    f"no slot has this outline ({area:.0f} mm²) within the tolerances",
                )
        return [candidate for candidate in found if candidate.blob not in self._refused]

    def decide(
        self, candidates: list[Candidate], registrations: list[Registration]
    ) -> tuple[list[LocatedPart], list[RejectedBlob]]:
        """Return the parts and the refused blobs."""
        locator = self._locator
        cost = np.full((len(self._blobs), len(locator.slots)), np.inf)
        best: dict[tuple[int, int], Registration] = {}
        failed: dict[int, tuple[float, str]] = {}
        for candidate, registration in zip(candidates, registrations, strict=True):
            key = (candidate.blob, candidate.slot)
            why = self._fault(registration)
            if why:
                if registration.evidence_mm < failed.get(candidate.blob, (math.inf, ""))[0]:
                    failed[candidate.blob] = (registration.evidence_mm, f"slot {candidate.slot}: {why}")
            elif registration.evidence_mm < cost[key]:
                cost[key] = registration.evidence_mm
                best[key] = registration
        possible = {blob for blob, _ in best}
        for index in failed:
            if index not in possible:
                self._refused[index] = (RejectionReason.NO_SLOT_FITS, f"nearest is {failed[index][1]}")
        allowed = cost.copy()
        allowed[:, [slot for slot in range(len(locator.slots)) if slot not in self._free]] = np.inf
        parts: list[LocatedPart] = []
        placed: set[int] = set()
        for blob, slot in assign(allowed):
            placed.add(blob)
            grasp = locator.grasps[slot]
            if grasp.point is None:
                self._refused[blob] = (RejectionReason.NO_GRASP, f"slot {slot}: {grasp.refusal}")
            else:
                parts.append(self._part(best[(blob, slot)], grasp.point))
        for blob in sorted(possible - placed):
            slots = ", ".join(str(slot) for other, slot in sorted(best) if other == blob)
            self._refused[blob] = (
                RejectionReason.SLOT_TAKEN,
                f"fits slot {slots}, which is filled or goes to a slab that fits better",
            )
        return sorted(parts, key=lambda part: part.slot), self._rejected()

    def _fault(self, registration: Registration) -> str:
        """Return why a registration is not accepted, or nothing."""
        limits = self._locator.recipe.matching
        if registration.coverage < MIN_COVERAGE:
            found, needed = 100 * registration.coverage, 100 * MIN_COVERAGE
            return f"only {found:.0f} % of its outline is there, {needed:.0f} % are needed"
        if registration.residual_mm > limits.max_residual_mm:
            return f"the outline is {registration.residual_mm:.2f} mm off, the limit is {limits.max_residual_mm:g} mm"
        score = self._score(registration)
        if score < limits.min_score:
            return f"score {score:.2f}, the limit is {limits.min_score:g}"
        return ""

    def _score(self, registration: Registration) -> float:
        """Return 1 for an outline that is wholly there and exactly fits, 0.8 at the limit of the residual."""
        relative = registration.residual_mm / self._locator.recipe.matching.max_residual_mm
        return max(0.0, registration.coverage * (1.0 - 0.2 * relative**2))

    def _part(self, registration: Registration, grasp: Points) -> LocatedPart:
        locator = self._locator
        slot = registration.candidate.slot
        order = locator.orders[slot]
        motion = _least_turn(registration.motion, locator.slots[slot].centroid, order)
        pick_x, pick_y = motion.apply(grasp)
        pick = PlanarPose(float(pick_x), float(pick_y), motion.rotation_deg)
        place = PlanarPose(float(grasp[0]), float(grasp[1]), 0.0)
        direction = np.deg2rad(motion.rotation_deg)
        reach = 5.0 * locator.plane.mm_per_px * np.array([np.cos(direction), np.sin(direction)])
        here = np.array([pick_x, pick_y])
        middle, ahead = locator.plane.to_pixels(np.array([here, here + reach]))
        seen = ahead - middle
        centre = motion.apply(locator.slots[slot].centroid)
        x, y, angle = _sigma_at(registration.covariance, here - centre)
        return LocatedPart(
            slot=slot,
            score=self._score(registration),
            residual_mm=registration.residual_mm,
            symmetry_order=order,
            image=ImagePose(float(middle[0]), float(middle[1]), float(np.rad2deg(np.arctan2(-seen[1], seen[0])))),
            table_to_assembly=motion.inverse(),
            pick=pick,
            place=place,
            sigma=Sigma(x, y, angle),
            outline_px=locator.plane.to_pixels(motion.apply(locator.slots[slot].vertices)),
        )

    def _rejected(self) -> list[RejectedBlob]:
        rejected: list[RejectedBlob] = []
        for index in sorted(self._refused):
            reason, detail = self._refused[index]
            u, v = self._blobs[index].polygon.mean(axis=0)
            area = float(self._shapes.area_mm2[index])
            rejected.append(RejectedBlob(float(u), float(v), area, reason, detail, self._blobs[index].polygon))
        return rejected


def _least_turn(motion: RigidTransform2D, middle: Points, order: int) -> RigidTransform2D:
    """Return, of the motions that look alike, the one that turns least."""
    step = 360.0 / order
    turn = normalize_deg(motion.rotation_deg)
    least = turn - step * round(turn / step)
    centre = motion.apply(middle)
    x, y = centre - RigidTransform2D(least, 0.0, 0.0).apply(middle)
    return RigidTransform2D(least, float(x), float(y))


def _sigma_at(covariance: npt.NDArray[np.float64], arm: Points) -> tuple[float, float, float]:
    """Return standard deviations of x, y (mm) and rotation (degrees) at a point ``arm`` beside the slot's middle."""
    jacobian = np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]], [0.0, 0.0, 1.0]])
    x, y, angle = np.sqrt(np.diag(jacobian @ covariance @ jacobian.T))
    return float(x), float(y), float(np.rad2deg(angle))
