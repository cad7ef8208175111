"""What does the vision say of one picture?  Located parts, refused blobs, empty slots and stage times.

`to_document` gives the JSON object of `slabcell locate --json` (schema ``slabcell.locate/1``).
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from slabcell.geometry import PlanarPose, Points, RigidTransform2D
from slabcell.vision.features import BlobFeatures

__all__ = ["GateReading", "ImagePose", "LocateResult", "LocatedPart", "RejectedBlob", "RejectionReason", "Sigma"]


class RejectionReason(StrEnum):
    """Why a blob is not a located part."""

    TOO_SMALL = "too_small"
    TOUCHES_BORDER = "touches_border"
    NO_SLOT_FITS = "no_slot_fits"
    SLOT_TAKEN = "slot_taken"
    TOUCHING = "touching"
    UNSURE = "unsure"
    NO_GRASP = "no_grasp"
    FILTERED = "filtered"


class ImagePose(NamedTuple):
    """The grasp point in the picture, in pixels, and the direction there of the part's X axis.

    The angle counts counter-clockwise as the picture is seen: from u towards minus v.
    """

    u: float
    v: float
    angle_deg: float


class Sigma(NamedTuple):
    """Standard deviations of the part's pose on the table."""

    x_mm: float
    y_mm: float
    a_deg: float


class LocatedPart(NamedTuple):
    """One slab that was found, and the slot it fills.

    ``table_to_assembly`` lays it there: assembly = R·table + t.  ``pick`` and ``place`` are the same physical point,
    the grasp point, on the table and in the assembly; place.a_deg − pick.a_deg is the rotation.  ``pick.a_deg`` is the
    direction on the table of the template's own X axis (``place.a_deg`` is 0), unless a gripper of several cups must
    be turned to fit: then ``place.a_deg`` is that turn.  ``symmetry_order`` says how many rotations of the part look
    alike.  ``outline_px`` is the outline in the picture, shape (n, 2), for overlays.  ``kerf_mm`` is how far the slab's
    edge lies outside of the drawn one, all around; ``coverage`` the share of the outline that is where it should be.
    ``blob`` is its index in the result's ``blobs``; a slab that was taken out of several that touch has none.  A tuple,
    because many are made for each picture.
    """

    slot: int
    score: float
    residual_mm: float
    symmetry_order: int
    image: ImagePose
    table_to_assembly: RigidTransform2D
    pick: PlanarPose
    place: PlanarPose
    sigma: Sigma
    outline_px: Points
    kerf_mm: float = 0.0
    coverage: float = 1.0
    blob: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RejectedBlob:
    """One blob that is not acted on, and why; ``blob`` is its index in the result's ``blobs``."""

    u: float
    v: float
    area_mm2: float
    reason: RejectionReason
    detail: str
    outline_px: Points
    blob: int | None = None


@dataclass(frozen=True, slots=True)
class GateReading:
    """One thing that a picture must be like: what was measured, and the limit it was held against."""

    gate: str
    value: float
    limit: float
    unit: str
    passed: bool
    detail: str


@dataclass(frozen=True, slots=True, eq=False)
class LocateResult:
    """Everything the vision found in one picture.  Stage times are in milliseconds, in the order of the stages.

    ``segmentation`` says how slabs were told from the table, ``implementation`` what measured the edges (``native`` or
    ``numpy``), ``gates`` what the picture was like.  ``blobs`` are the features of all blobs, or None where the recipe
    does not ask for them.
    """

    parts: tuple[LocatedPart, ...]
    rejected: tuple[RejectedBlob, ...]
    empty_slots: tuple[int, ...]
    timing_ms: dict[str, float]
    segmentation: str = ""
    implementation: str = ""
    gates: tuple[GateReading, ...] = ()
    blobs: tuple[BlobFeatures, ...] | None = None

    def to_document(self, image: str) -> dict[str, object]:
        """Return the ``slabcell.locate/1`` object; ``image`` names the picture."""
        document: dict[str, object] = {
            "schema": "slabcell.locate/1",
            "image": image,
            "segmentation": self.segmentation,
            "implementation": self.implementation,
            "gates": [
                {"gate": gate.gate, "value": round(gate.value, 3), "limit": gate.limit, "unit": gate.unit}
                for gate in self.gates
            ],
            "parts": [_part(part) for part in self.parts],
            "rejected": [
                {
                    "image": {"u": round(blob.u, 3), "v": round(blob.v, 3)},
                    "area_mm2": round(blob.area_mm2, 2),
                    "reason": blob.reason.value,
                    "detail": blob.detail,
                }
                for blob in self.rejected
            ],
            "empty_slots": list(self.empty_slots),
            "timing_ms": {stage: round(value, 3) for stage, value in self.timing_ms.items()},
        }
        if self.blobs is not None:
            slots = {part.blob: part.slot for part in self.parts}
            reasons = {blob.blob: blob.reason.value for blob in self.rejected}
            document["blobs"] = [
                {**blob.to_document(), "slot": slots.get(index), "reason": reasons.get(index)}
                for index, blob in enumerate(self.blobs)
            ]
        return document


def _part(part: LocatedPart) -> dict[str, object]:
    return {
        "slot": part.slot,
        "score": round(part.score, 4),
        "residual_mm": round(part.residual_mm, 4),
        "coverage": round(part.coverage, 4),
        "kerf_mm": round(part.kerf_mm, 4),
        "symmetry_order": part.symmetry_order,
        "image": {
            "u": round(part.image.u, 3),
            "v": round(part.image.v, 3),
            "angle_deg": round(part.image.angle_deg, 4),
        },
        "table_to_assembly": {
            "rotation_deg": round(part.table_to_assembly.rotation_deg, 5),
            "x_mm": round(part.table_to_assembly.x_mm, 4),
            "y_mm": round(part.table_to_assembly.y_mm, 4),
        },
        "pick": _pose(part.pick),
        "place": _pose(part.place),
        "sigma": {
            "x_mm": round(part.sigma.x_mm, 5),
            "y_mm": round(part.sigma.y_mm, 5),
            "a_deg": round(part.sigma.a_deg, 5),
        },
    }


def _pose(pose: PlanarPose) -> dict[str, float]:
    return {"x_mm": round(pose.x_mm, 4), "y_mm": round(pose.y_mm, 4), "a_deg": round(pose.a_deg, 5)}
