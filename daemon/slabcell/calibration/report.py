"""How is a calibration told to a program?  The objects of `slabcell calibrate --json`, and of the control API.

``out`` is what the calibration was written to, ``failures`` a line for each picture without a board.
"""

from collections.abc import Sequence

import numpy as np

from slabcell.calibration.camera import CameraResult
from slabcell.calibration.handeye import HandEyeResult
from slabcell.calibration.plane import PlaneResult

__all__ = ["camera_document", "hand_eye_document", "plane_document"]


def camera_document(result: CameraResult, out: str, failures: Sequence[str]) -> dict[str, object]:
    """Return the ``slabcell.calibrate-camera/1`` object.

    ``residuals`` are u, v and what is left in u and v of every point, in pixels.
    """
    lens = result.calibration.lens
    return {
        "schema": "slabcell.calibrate-camera/1",
        "out": out,
        "rms_px": result.rms_px,
        "holdout_px": result.holdout_px if np.isfinite(result.holdout_px) else None,
        "focal_distance_correlation": result.focal_distance_correlation,
        "lens": {"model": lens.model, "matrix": lens.matrix.tolist(), "distortion": lens.distortion.tolist()},
        "std": result.std,
        "views": [
            {"name": v.name, "points": v.points, "rms_px": v.rms_px, "used": v.used, "tilt_deg": v.tilt_deg}
            for v in result.views
        ],
        "coverage": result.coverage.to_document(),
        "residuals": np.round(result.residuals, 3).tolist(),
        "not_found": list(failures),
        "warnings": list(result.warnings),
    }


def plane_document(result: PlaneResult, out: str, failures: Sequence[str]) -> dict[str, object]:
    """Return the ``slabcell.calibrate-plane/1`` object."""
    plane = result.calibration.require_plane()
    return {
        "schema": "slabcell.calibrate-plane/1",
        "out": out,
        "rms_px": result.rms_px,
        "plane": {
            "rotation": plane.rotation.tolist(),
            "translation_mm": plane.translation.tolist(),
            "adjustment": plane.adjustment.tolist(),
        },
        "views": [
            {"name": v.name, "rms_px": v.rms_px, "rms_mm": v.rms_mm, "lift_mm": v.lift_mm, "tilt_deg": v.tilt_deg}
            for v in result.views
        ],
        "touch": result.touch.to_document() if result.touch else None,
        "not_found": list(failures),
        "warnings": list(result.warnings),
    }


def hand_eye_document(result: HandEyeResult, out: str, failures: Sequence[str]) -> dict[str, object]:
    """Return the ``slabcell.calibrate-hand-eye/1`` object."""
    document = {"schema": "slabcell.calibrate-hand-eye/1", "out": out, **result.to_document()}
    return {**document, "not_found": list(failures)}
