"""How is a registered slab picked and placed?  Located parts, from registrations that were chosen.

All parts of a picture are worked out together: what is wanted in pixels is projected at once.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from slabcell.geometry import PlanarPose, RigidTransform2D, normalize_deg
from slabcell.recipe import MatchingParameters
from slabcell.vision.kernel import engine
from slabcell.vision.prepared import Prepared
from slabcell.vision.registration import Registration
from slabcell.vision.result import ImagePose, LocatedPart, Sigma

__all__ = ["located_parts", "score_of"]

Complex = npt.NDArray[np.complex128]

# The part's X axis is drawn over this length to find its direction in the picture.
ARROW_PX = 5.0


def score_of(registration: Registration, limits: MatchingParameters) -> float:
    """Return 1 for an outline that is wholly there and exactly fits, 0.8 at the limit of the residual."""
    relative = registration.residual_mm / limits.max_residual_mm
    return max(0.0, registration.coverage * (1.0 - 0.2 * relative**2))


def located_parts(prepared: Prepared, chosen: Sequence[Registration], blobs: int) -> list[LocatedPart]:
    """Return the parts in the order of their slots; all of these slots have a grasp.

    ``blobs``: how many the picture has of its own; those after them were taken out of several that touch.
    """
    if not chosen:
        return []
    chosen = sorted(chosen, key=lambda item: item.candidate.slot)
    slots = np.array([item.candidate.slot for item in chosen])
    middles, points, orders = prepared.middles[slots], prepared.grasp_points[slots], prepared.turns[slots]
    # Of the motions that look alike, the one that turns least, about the middle of the slot.
    turns = np.rad2deg([item.rotation for item in chosen])
    shifts = np.array([complex(item.x_mm, item.y_mm) for item in chosen])
    centres = np.exp(1j * np.deg2rad(turns)) * middles + shifts
    step = 360.0 / orders
    turns = turns - step * np.rint(turns / step)
    unit = np.exp(1j * np.deg2rad(turns))
    shifts = centres - unit * middles
    here = unit * points + shifts
    back = -np.conj(unit) * shifts
    # In the picture: grasp, direction, outline.
    count = len(chosen)
    corners: list[Complex] = [prepared.corners[item.candidate.slot] for item in chosen]
    stops = list(itertools.accumulate((len(item) for item in corners), initial=2 * count))
    points_mm = np.empty(stops[-1], np.complex128)
    points_mm[:count], points_mm[count : 2 * count] = here, here + ARROW_PX * prepared.plane.mm_per_px * unit
    for index, item in enumerate(corners):
        points_mm[stops[index] : stops[index + 1]] = unit[index] * item + shifts[index]
    pixels = engine().to_pixels(prepared.plane, points_mm.view(np.float64).reshape(-1, 2))
    seen, tip = pixels[:count], pixels[count : 2 * count]
    angles = np.degrees(np.arctan2(seen[:, 1] - tip[:, 1], tip[:, 0] - seen[:, 0]))
    numbers = np.empty((count, 13))
    numbers[:, 0], numbers[:, 1], numbers[:, 2] = turns, back.real, back.imag
    numbers[:, 3], numbers[:, 4], numbers[:, 5], numbers[:, 6] = here.real, here.imag, points.real, points.imag
    numbers[:, 7:9], numbers[:, 9] = seen, angles
    numbers[:, 10:] = _sigmas(np.array([item.covariance for item in chosen]), here - centres)
    parts: list[LocatedPart] = []
    for index, (item, row) in enumerate(zip(chosen, numbers.tolist(), strict=True)):
        turn, back_x, back_y, x, y, place_x, place_y, u, v, angle, *sigma = row
        slot, blob = item.candidate.slot, item.candidate.blob
        turned = prepared.grasps[slot].turn_deg
        parts.append(
            LocatedPart(
                slot=slot,
                score=score_of(item, prepared.recipe.matching),
                residual_mm=item.residual_mm,
                symmetry_order=prepared.orders[slot],
                image=ImagePose(u, v, angle),
                table_to_assembly=RigidTransform2D(-turn, back_x, back_y),
                pick=PlanarPose(x, y, normalize_deg(turn + turned)),
                place=PlanarPose(place_x, place_y, turned),
                sigma=Sigma(*sigma),
                outline_px=pixels[stops[index] : stops[index + 1]],
                kerf_mm=item.kerf_mm,
                coverage=item.coverage,
                blob=blob if blob < blobs else None,
            )
        )
    return parts


def _sigmas(covariance: npt.NDArray[np.float64], arm: Complex) -> npt.NDArray[np.float64]:
    """Return standard deviations of x, y (mm) and rotation (degrees) at points ``arm`` beside the slots' middles."""
    right, up = arm.real, arm.imag
    xx, yy, tt = covariance[:, 0, 0], covariance[:, 1, 1], covariance[:, 2, 2]
    x = xx - 2.0 * up * covariance[:, 0, 2] + up * up * tt
    y = yy + 2.0 * right * covariance[:, 1, 2] + right * right * tt
    variances = np.stack([x, y, tt * math.degrees(1.0) ** 2], axis=1)
    return np.sqrt(np.maximum(variances, 0.0))
