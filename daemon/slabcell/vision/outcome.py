"""What becomes of each blob of a picture?  Its slot and poses, or why it is refused."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from slabcell.geometry import PlanarPose, Points, RigidTransform2D, normalize_deg
from slabcell.vision.ambiguity import Explanation, doubts
from slabcell.vision.blobs import RawBlob
from slabcell.vision.classic import classic_distances
from slabcell.vision.describe import Shapes
from slabcell.vision.grasp import Grasp
from slabcell.vision.matching import Candidate, assign, find_candidates
from slabcell.vision.pixels import Grey
from slabcell.vision.prepared import Prepared
from slabcell.vision.registration import Registration
from slabcell.vision.result import ImagePose, LocatedPart, RejectedBlob, RejectionReason, Sigma
from slabcell.vision.touching import split_blob

__all__ = ["Outcome"]

# Bound on blobs, those that were taken apart included.
MAX_PARTS = 2000
# What the whole-outline registration may be off before the edges are measured: in pixels, and in parts of the size.
COARSE_PX = 1.5
COARSE_SHARE = 0.01
# ... and of the width of the walls that are seen, which are taken off only roughly.
WALL_SHARE = 0.35


class Outcome:
    """What becomes of each blob of one picture.  ``filtered``: blobs that the recipe's filters refuse, and why."""

    def __init__(
        self,
        prepared: Prepared,
        blobs: list[RawBlob],
        shapes: Shapes,
        free: set[int],
        filtered: Mapping[int, str] | None = None,
    ) -> None:
        self._prepared = prepared
        self._blobs = blobs
        # Those after the picture's own were taken out of several that touch.
        self._own = len(blobs)
        self._shapes = shapes
        self._free = free
        self._areas: list[float] = shapes.area_mm2.tolist()
        self._refused = {key: (RejectionReason.FILTERED, why) for key, why in (filtered or {}).items()}
        self._distance: npt.NDArray[np.float64] | None = None

    def candidates(self) -> list[Candidate]:
        """Return what each blob may be, and refuse those that can be nothing."""
        prepared = self._prepared
        scale = prepared.plane.mm_per_px
        size = np.sqrt(prepared.shapes.area_mm2)
        tolerance = prepared.recipe.matching.area_tolerance
        method = prepared.recipe.matching.method
        if method != "registration":
            self._distance = classic_distances(self._shapes, prepared.shapes, prepared.recipe.matching)
        found = find_candidates(
            self._shapes,
            prepared.shapes,
            area_tolerance=tolerance,
            limit_mm=(COARSE_PX + WALL_SHARE * prepared.widest_wall_px) * scale
            + COARSE_SHARE * size
            + prepared.recipe.matching.max_residual_mm,
            margin_mm=0.5 * scale,
            symmetry_order=prepared.orders,
            allowed=None if self._distance is None else np.isfinite(self._distance),
        )
        hopeful = {candidate.blob for candidate in found}
        areas = prepared.shapes.area_mm2
        for index, blob in enumerate(self._blobs):
            area = float(self._shapes.area_mm2[index])
            if index in self._refused:
                continue
            if blob.touches_rim and prepared.recipe.segmentation.border == "reject":
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

    def split_touching(self, grey: Grey, mask: npt.NDArray[np.uint8]) -> tuple[list[Candidate], list[Registration]]:
        """Take blobs apart that are larger than every slot, where slots explain them; each slab becomes a blob."""
        candidates: list[Candidate] = []
        registrations: list[Registration] = []
        if not self._prepared.recipe.matching.split_touching:
            return candidates, registrations
        for index in self._perhaps_several():
            if len(registrations) + len(self._blobs) > MAX_PARTS:
                break
            for found in split_blob(self._prepared, grey, mask, index, self._blobs[index]):
                slot = self._prepared.slots[found[0].candidate.slot]
                outline = self._prepared.plane.to_pixels(found[0].motion.apply(slot.vertices))
                self._blobs.append(RawBlob(outline, 0.0, touches_rim=False))
                self._areas.append(slot.area_mm2)
                for item in found:
                    own = replace(item.candidate, blob=len(self._blobs) - 1)
                    candidates.append(own)
                    registrations.append(replace(item, candidate=own))
                self._refused.pop(index, None)
        return candidates, registrations

    def _perhaps_several(self) -> list[int]:
        """Return the refused blobs that are as large as two slabs, wholly in the picture."""
        areas = np.sort(self._prepared.shapes.area_mm2)
        least = 0.9 * float(areas[:2].sum())
        reasons = (RejectionReason.TOUCHING, RejectionReason.NO_SLOT_FITS)
        return [key for key, (reason, _) in self._refused.items() if reason in reasons and self._areas[key] >= least]

    def decide(
        self, candidates: list[Candidate], registrations: list[Registration]
    ) -> tuple[list[LocatedPart], list[RejectedBlob]]:
        """Return the parts and the refused blobs."""
        prepared = self._prepared
        cost = np.full((len(self._blobs), len(prepared.slots)), np.inf)
        best: dict[tuple[int, int], Registration] = {}
        failed: dict[int, tuple[float, str]] = {}
        explanations: list[Explanation] = []
        for candidate, registration in zip(candidates, registrations, strict=True):
            key = (candidate.blob, candidate.slot)
            why = self._fault(registration)
            if why:
                if registration.evidence_mm < failed.get(candidate.blob, (math.inf, ""))[0]:
                    failed[candidate.blob] = (registration.evidence_mm, f"slot {candidate.slot}: {why}")
                continue
            explanations.append(Explanation(*key, registration.motion.rotation_deg, registration.evidence_mm))
            if key not in best or registration.evidence_mm < best[key].evidence_mm:
                classic = self._distance is not None and candidate.blob < len(self._distance)
                # Squares, because their sum says how likely all of it together is.
                square = registration.evidence_mm**2
                cost[key] = self._distance[key] if classic and self._distance is not None else square
                best[key] = registration
        possible = {blob for blob, _ in best}
        for index in failed:
            if index not in possible:
                self._refused[index] = (RejectionReason.NO_SLOT_FITS, f"nearest is {failed[index][1]}")
        allowed = cost.copy()
        allowed[:, [slot for slot in range(len(prepared.slots)) if slot not in self._free]] = np.inf
        chosen: list[tuple[Registration, Grasp]] = []
        placed: set[int] = set()
        assigned = dict(assign(allowed))
        unsure = self._doubts(explanations, assigned)
        for blob, slot in assigned.items():
            placed.add(blob)
            grasp = prepared.grasps[slot]
            if blob in unsure:
                self._refused[blob] = (RejectionReason.UNSURE, unsure[blob])
            elif grasp.point is None:
                self._refused[blob] = (RejectionReason.NO_GRASP, f"slot {slot}: {grasp.refusal}")
            else:
                chosen.append((best[(blob, slot)], grasp))
        for blob in sorted(possible - placed):
            slots = ", ".join(str(slot) for other, slot in sorted(best) if other == blob)
            self._refused[blob] = (
                RejectionReason.SLOT_TAKEN,
                f"fits slot {slots}, which is filled or goes to a slab that fits better",
            )
        return sorted(self._parts(chosen), key=lambda part: part.slot), self._rejected()

    def _doubts(self, explanations: list[Explanation], assigned: dict[int, int]) -> dict[int, str]:
        """Return for each blob of which another slot or rotation explains as much why it is refused."""
        if len(explanations) == len(assigned):
            return {}
        prepared = self._prepared
        return doubts(
            explanations,
            assigned,
            kinds=prepared.kinds,
            orders=prepared.orders,
            free=self._free,
            min_lead_mm=prepared.recipe.matching.min_lead_mm,
        )

    def _fault(self, registration: Registration) -> str:
        """Return why a registration is not accepted, or nothing."""
        limits = self._prepared.recipe.matching
        if registration.coverage < limits.min_coverage:
            found, needed = 100 * registration.coverage, 100 * limits.min_coverage
            return f"only {found:.0f} % of its outline is there, {needed:.0f} % are needed"
        if registration.residual_mm > limits.max_residual_mm:
            return f"the outline is {registration.residual_mm:.2f} mm off, the limit is {limits.max_residual_mm:g} mm"
        score = self._score(registration)
        if score < limits.min_score:
            return f"score {score:.2f}, the limit is {limits.min_score:g}"
        return ""

    def _score(self, registration: Registration) -> float:
        """Return 1 for an outline that is wholly there and exactly fits, 0.8 at the limit of the residual."""
        relative = registration.residual_mm / self._prepared.recipe.matching.max_residual_mm
        return max(0.0, registration.coverage * (1.0 - 0.2 * relative**2))

    def _parts(self, chosen: list[tuple[Registration, Grasp]]) -> list[LocatedPart]:
        """Return the located parts; all that is wanted in pixels is projected together."""
        prepared = self._prepared
        if not chosen:
            return []
        motions: list[RigidTransform2D] = []
        points: list[Points] = []
        for registration, grasp in chosen:
            slot = registration.candidate.slot
            motion = _least_turn(registration.motion, prepared.slots[slot].centroid, prepared.orders[slot])
            here = motion.apply(_point(grasp))
            direction = np.deg2rad(motion.rotation_deg)
            ahead = here + 5.0 * prepared.plane.mm_per_px * np.array([np.cos(direction), np.sin(direction)])
            motions.append(motion)
            points += [here[None, :], ahead[None, :], motion.apply(prepared.slots[slot].vertices)]
        pixels = np.split(
            prepared.plane.to_pixels(np.concatenate(points)), np.cumsum([len(item) for item in points])[:-1]
        )
        return [
            self._part(
                registration, grasp, motion, pixels[3 * index][0], pixels[3 * index + 1][0], pixels[3 * index + 2]
            )
            for index, ((registration, grasp), motion) in enumerate(zip(chosen, motions, strict=True))
        ]

    def _part(
        self,
        registration: Registration,
        grasp: Grasp,
        motion: RigidTransform2D,
        middle: Points,
        ahead: Points,
        outline_px: Points,
    ) -> LocatedPart:
        prepared = self._prepared
        slot = registration.candidate.slot
        point = _point(grasp)
        here = motion.apply(point)
        x, y, angle = _sigma_at(registration.covariance, here - motion.apply(prepared.slots[slot].centroid))
        seen = ahead - middle
        return LocatedPart(
            slot=slot,
            score=self._score(registration),
            residual_mm=registration.residual_mm,
            symmetry_order=prepared.orders[slot],
            image=ImagePose(float(middle[0]), float(middle[1]), float(np.rad2deg(np.arctan2(-seen[1], seen[0])))),
            table_to_assembly=motion.inverse(),
            pick=PlanarPose(float(here[0]), float(here[1]), normalize_deg(motion.rotation_deg + grasp.turn_deg)),
            place=PlanarPose(float(point[0]), float(point[1]), grasp.turn_deg),
            sigma=Sigma(x, y, angle),
            outline_px=outline_px,
            kerf_mm=registration.kerf_mm,
            coverage=registration.coverage,
            blob=self._number(registration.candidate.blob),
        )

    def _number(self, blob: int) -> int | None:
        return blob if blob < self._own else None

    def _rejected(self) -> list[RejectedBlob]:
        rejected: list[RejectedBlob] = []
        for index in sorted(self._refused):
            reason, detail = self._refused[index]
            u, v = self._blobs[index].polygon.mean(axis=0)
            area = self._areas[index]
            outline = self._blobs[index].polygon
            rejected.append(RejectedBlob(float(u), float(v), area, reason, detail, outline, self._number(index)))
        return rejected


def _point(grasp: Grasp) -> Points:
    if grasp.point is None:
        msg = "a slab without a grasp point is never located"
        raise ValueError(msg)
    return grasp.point


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
    right, up = float(arm[0]), float(arm[1])
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = covariance.tolist()
    del xy
    x = math.sqrt(max(xx - 2.0 * up * xt + up * up * tt, 0.0))
    y = math.sqrt(max(yy + 2.0 * right * yt + right * right * tt, 0.0))
    return x, y, math.degrees(math.sqrt(max(tt, 0.0)))
