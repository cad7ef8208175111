"""What becomes of each blob of a picture?  Its slot and poses, or why it is refused."""

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from slabcell.vision.ambiguity import Explanation, doubts
from slabcell.vision.blobs import Blobs, RawBlob
from slabcell.vision.classic import classic_distances
from slabcell.vision.kernel import engine
from slabcell.vision.matching import Candidate, assign
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


class Outcome:
    """What becomes of each blob of one picture.  ``filtered``: blobs that the recipe's filters refuse, and why."""

    def __init__(
        self,
        prepared: Prepared,
        blobs: Blobs,
        shapes: Shapes,
        free: set[int],
        filtered: Mapping[int, str] | None = None,
    ) -> None:
        self._prepared = prepared
        self._blobs = blobs
        # Slabs that were taken out of several that touch; they are numbered on after the picture's own blobs.
        self._parted: list[RawBlob] = []
        self._shapes = shapes
        self._free = free
        self._areas: list[float] = shapes.area_mm2.tolist()
        self._refused = {key: (RejectionReason.FILTERED, why) for key, why in (filtered or {}).items()}
        self._distance: npt.NDArray[np.float64] | None = None

    def candidates(self) -> list[Candidate]:
        """Return what each blob may be, and refuse those that can be nothing."""
        prepared = self._prepared
        method = prepared.recipe.matching.method
        if method != "registration":
            self._distance = classic_distances(self._shapes, prepared.shapes, prepared.recipe.matching)
        allowed = None if self._distance is None else np.isfinite(self._distance)
        found = engine().find_candidates(self._shapes, prepared.shapes, prepared.limits, allowed)
        hopeful = {candidate.blob for candidate in found}
        whole_only = prepared.recipe.segmentation.border == "reject"
        for index, touches_rim in enumerate(self._blobs.touches_rim):
            if index in self._refused:
                continue
            if touches_rim and whole_only:
                self._refused[index] = (RejectionReason.TOUCHES_BORDER, "the rim of the picture cuts it")
            elif index not in hopeful:
                self._refused[index] = self._hopeless(self._areas[index])
        if not self._refused:
            return found
        return [candidate for candidate in found if candidate.blob not in self._refused]

    def _hopeless(self, area: float) -> tuple[RejectionReason, str]:
        """Return why a blob of this area (mm²) that is like no slot is refused."""
        areas, tolerance = self._prepared.sorted_areas_mm2, self._prepared.recipe.matching.area_tolerance
        if area < areas[0] * (1.0 - tolerance):
            return RejectionReason.TOO_SMALL, f"{area:.0f} mm², the smallest slot has {areas[0]:.0f} mm²"
        if area > areas[-1] * (1.0 + tolerance):
            text = f"{area:.0f} mm², the largest slot has {areas[-1]:.0f} mm²: slabs that touch, or no slab"
            return RejectionReason.TOUCHING, text
        return RejectionReason.NO_SLOT_FITS, f"no slot has this outline ({area:.0f} mm²) within the tolerances"

    def split_touching(self, grey: Grey, segmentation: Segmentation) -> tuple[list[Candidate], list[Registration]]:
        """Take blobs apart that are larger than every slot, where slots explain them; each slab becomes a blob."""
        candidates: list[Candidate] = []
        registrations: list[Registration] = []
        if not self._refused or not self._prepared.recipe.matching.split_touching:
            return candidates, registrations
        for index in self._perhaps_several():
            if len(registrations) + len(self._areas) > MAX_PARTS:
                break
            for found in split_blob(self._prepared, grey, segmentation.mask, index, self._blobs[index]):
                slot = self._prepared.slots[found[0].candidate.slot]
                outline = self._prepared.plane.to_pixels(found[0].motion.apply(slot.vertices))
                self._parted.append(RawBlob(outline, 0.0, touches_rim=False))
                self._areas.append(slot.area_mm2)
                for item in found:
                    own = item.candidate._replace(blob=len(self._areas) - 1)
                    candidates.append(own)
                    registrations.append(item._replace(candidate=own))
                self._refused.pop(index, None)
        return candidates, registrations

    def _perhaps_several(self) -> list[int]:
        """Return the refused blobs that are as large as two slabs, wholly in the picture."""
        least = 0.9 * sum(self._prepared.sorted_areas_mm2[:2])
        reasons = (RejectionReason.TOUCHING, RejectionReason.NO_SLOT_FITS)
        return [key for key, (reason, _) in self._refused.items() if reason in reasons and self._areas[key] >= least]

    def decide(
        self, candidates: list[Candidate], registrations: list[Registration]
    ) -> tuple[list[LocatedPart], list[RejectedBlob]]:
        """Return the parts and the refused blobs."""
        prepared = self._prepared
        best: dict[tuple[int, int], Registration] = {}
        failed: dict[int, tuple[float, str]] = {}
        accepted: list[Registration] = []
        for candidate, registration in zip(candidates, registrations, strict=True):
            why = self._fault(registration)
            if why:
                if registration.evidence_mm < failed.get(candidate.blob, (math.inf, ""))[0]:
                    failed[candidate.blob] = (registration.evidence_mm, f"slot {candidate.slot}: {why}")
                continue
            accepted.append(registration)
            key = candidate[:2]
            if key not in best or registration.evidence_mm < best[key].evidence_mm:
                best[key] = registration
        possible = {blob for blob, _ in best}
        for index in failed:
            if index not in possible:
                self._refused[index] = (RejectionReason.NO_SLOT_FITS, f"nearest is {failed[index][1]}")
        chosen: list[Registration] = []
        assigned = self._assigned(best)
        unsure = self._doubts(accepted, assigned)
        for blob, slot in assigned.items():
            grasp = prepared.grasps[slot]
            if blob in unsure:
                self._refused[blob] = (RejectionReason.UNSURE, unsure[blob])
            elif grasp.point is None:
                self._refused[blob] = (RejectionReason.NO_GRASP, f"slot {slot}: {grasp.refusal}")
            else:
                chosen.append(best[(blob, slot)])
        for blob in sorted(possible - assigned.keys()):
            slots = ", ".join(str(slot) for other, slot in sorted(best) if other == blob)
            self._refused[blob] = (
                RejectionReason.SLOT_TAKEN,
                f"fits slot {slots}, which is filled or goes to a slab that fits better",
            )
        return located_parts(prepared, chosen, len(self._blobs)), self._rejected()

    def _assigned(self, best: Mapping[tuple[int, int], Registration]) -> dict[int, int]:
        """Return the slot of each blob that gets one, of those that are free, such that all together fit best."""
        cost: dict[tuple[int, int], float] = {}
        wanted: dict[int, tuple[float, int]] = {}
        for key, registration in best.items():
            blob, slot = key
            if slot not in self._free:
                continue
            if self._distance is not None and blob < len(self._distance):
                cost[key] = float(self._distance[key])
            else:
                # Squares, because their sum says how likely all of it together is.
                cost[key] = registration.evidence_mm**2
            if blob not in wanted or cost[key] < wanted[blob][0]:
                wanted[blob] = (cost[key], slot)
        # Where no two blobs want the same slot each may have the one that it fits best.
        if len({slot for _, slot in wanted.values()}) == len(wanted):
            return {blob: slot for blob, (_, slot) in wanted.items()}
        table = np.full((len(self._areas), len(self._prepared.slots)), np.inf)
        for key, value in cost.items():
            table[key] = value
        return dict(assign(table))

    def _doubts(self, accepted: list[Registration], assigned: dict[int, int]) -> dict[int, str]:
        """Return for each blob of which another slot or rotation explains as much why it is refused."""
        if len(accepted) == len(assigned):
            return {}
        prepared = self._prepared
        return doubts(
            [Explanation(*item.candidate[:2], math.degrees(item.rotation), item.evidence_mm) for item in accepted],
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
        return blob if blob < len(self._blobs) else None

    def _rejected(self) -> list[RejectedBlob]:
        rejected: list[RejectedBlob] = []
        for index in sorted(self._refused):
            reason, detail = self._refused[index]
            own = self._number(index)
            outline = self._parted[index - len(self._blobs)].polygon if own is None else self._blobs[own].polygon
            u, v = outline.mean(axis=0)
            area = self._areas[index]
            rejected.append(RejectedBlob(float(u), float(v), area, reason, detail, outline, own))
        return rejected
