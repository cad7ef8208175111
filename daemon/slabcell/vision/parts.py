"""How is a registered slab picked and placed?  Located parts, from registrations that were chosen."""

from collections.abc import Sequence
from operator import attrgetter

from slabcell.geometry import PlanarPose, RigidTransform2D, normalize_deg
from slabcell.recipe import MatchingParameters
from slabcell.vision.kernel import engine
from slabcell.vision.prepared import Prepared
from slabcell.vision.registration import Registration
from slabcell.vision.result import ImagePose, LocatedPart, Sigma

__all__ = ["located_parts", "score_of"]

_slot = attrgetter("candidate.slot")


def score_of(registration: Registration, limits: MatchingParameters) -> float:
    """Return 1 for an outline that is wholly there and exactly fits, 0.8 at the limit of the residual."""
    relative = registration.residual_mm / limits.max_residual_mm
    score = registration.coverage * (1.0 - 0.2 * relative * relative)
    return score if score > 0.0 else 0.0


def located_parts(prepared: Prepared, chosen: Sequence[Registration], blobs: int) -> list[LocatedPart]:
    """Return the parts in the order of their slots; all of these slots have a grasp.

    ``blobs``: how many the picture has of its own; those after them were taken out of several that touch.
    """
    if not chosen:
        return []
    chosen = sorted(chosen, key=_slot)
    poses = engine().part_poses(prepared.plane, prepared.slot_table, chosen)
    limits, grasps, orders = prepared.recipe.matching, prepared.grasps, prepared.orders
    parts: list[LocatedPart] = []
    for item, row, outline in zip(chosen, poses.numbers, poses.outlines, strict=True):
        turn, back_x, back_y, x, y, place_x, place_y, u, v, angle, *sigma = row
        blob, slot = item.candidate[:2]
        turned = grasps[slot].turn_deg
        parts.append(
            LocatedPart(
                slot=slot,
                score=score_of(item, limits),
                residual_mm=item.residual_mm,
                symmetry_order=orders[slot],
                image=ImagePose(u, v, angle),
                table_to_assembly=RigidTransform2D(-turn, back_x, back_y),
                pick=PlanarPose(x, y, normalize_deg(turn + turned)),
                place=PlanarPose(place_x, place_y, turned),
                sigma=Sigma(*sigma),
                outline_px=outline,
                kerf_mm=item.kerf_mm,
                coverage=item.coverage,
                blob=blob if blob < blobs else None,
            )
        )
    return parts
