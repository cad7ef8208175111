"""What becomes of each blob of a picture?  Its slot and poses, or why it is refused."""

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from slabcell.vision.ambiguity import Explanation, doubts
from slabcell.vision.blobs import RawBlob
from slabcell.vision.classic import classic_distances
from slabcell.vision.kernel import engine
from slabcell.vision.matching import Candidate, MatchLimits, assign
from slabcell.vision.parts import located_parts, score_of
from slabcell.vision.pixels import Grey
from slabcell.vision.prepared import Prepared
from slabcell.vision.registration import Registration
from slabcell.vision.result import LocatedPart, RejectedBlob, RejectionReason
from slabcell.vision.segmentation import Segmentation
from slabcell.vision.shapes import Shapes
from slabcell.vision.touching import split_blob

__all__ = ["Outcome"]

# Bound on blobs, those that were taken apart included.
MAX_PARTS = 2000
# What the whole-outline registration may be off before the edges are measured: in pixels, and in parts of the size.
COARSE_PX = 1.5
COARSE_SHARE = 0.01
# What the threshold's outline scatters at least.
FLOOR_PX = 0.1
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
        limits = MatchLimits(
            distance_mm=(COARSE_PX + WALL_SHARE * prepared.widest_wall_px) * scale
            + COARSE_SHARE * size
            + prepared.recipe.matching.max_residual_mm,
            symmetry_order=prepared.orders,
            margin_mm=0.5 * scale,
            floor_mm=FLOOR_PX * scale,
            area=tolerance,
        )
        allowed = None if self._distance is None else np.isfinite(self._distance)
        found = engine().find_candidates(self._shapes, prepared.shapes, limits, allowed)
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

    def split_touching(self, grey: Grey, segmentation: Segmentation) -> tuple[list[Candidate], list[Registration]]:
        """Take blobs apart that are larger than every slot, where slots explain them; each slab becomes a blob."""
        candidates: list[Candidate] = []
        registrations: list[Registration] = []
        if not self._prepared.recipe.matching.split_touching:
            return candidates, registrations
        for index in self._perhaps_several():
            if len(registrations) + len(self._blobs) > MAX_PARTS:
                break
            for found in split_blob(self._prepared, grey, segmentation.mask, index, self._blobs[index]):
                slot = self._prepared.slots[found[0].candidate.slot]
                outline = self._prepared.plane.to_pixels(found[0].motion.apply(slot.vertices))
                self._blobs.append(RawBlob(outline, 0.0, touches_rim=False))
                self._areas.append(slot.area_mm2)
                for item in found:
                    own = item.candidate._replace(blob=len(self._blobs) - 1)
                    candidates.append(own)
                    registrations.append(item._replace(candidate=own))
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
            explanations.append(Explanation(*key, math.degrees(registration.rotation), registration.evidence_mm))
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
        chosen: list[Registration] = []
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
                chosen.append(best[(blob, slot)])
        for blob in sorted(possible - placed):
            slots = ", ".join(str(slot) for other, slot in sorted(best) if other == blob)
            self._refused[blob] = (
                RejectionReason.SLOT_TAKEN,
                f"fits slot {slots}, which is filled or goes to a slab that fits better",
            )
        return located_parts(prepared, chosen, self._own), self._rejected()

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
        score = score_of(registration, limits)
        if score < limits.min_score:
            return f"score {score:.2f}, the limit is {limits.min_score:g}"
        return ""

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
