"""How is a cycle kept, so that it can be looked at and run again?  One zip file: picture, parameters, result, record.

========================  ==============================================================================
``manifest.json``         ``slabcell.bundle/1``: cycle, times, versions, and the names of the other files
``cell.json``             arm, tool, bases and areas
``frame.png``             the picture, lossless
``recipe.json``           template and parameters as they were used
``calibration.json``      ``slabcell.calibration/1``
``result.json``           ``slabcell.locate/1``
``overlay.json``          the same with the outlines, to draw over the picture
``ledger.json``           what the ledger holds of the job when the cycle ended
``telegrams.json``        what went over the wire for them, byte by byte, with the time of the monotonic clock
``transcript.json``       the requests of the robot and the answers to them
``as-built.*``            with a verification: how the slabs lie, as JSON, CSV and picture
========================  ==============================================================================
"""

from __future__ import annotations

import json
import math
import platform
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from io import BytesIO

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.file import to_document as calibration_document
from slabcell.calibration.model import Calibration
from slabcell.cell.asbuilt import AsBuilt
from slabcell.cell.events import CycleRecord
from slabcell.cell.settings import CellSettings
from slabcell.recipe import Recipe
from slabcell.vision.outlines import overlay_document
from slabcell_drivers.robot.arm import ArmModel

__all__ = ["SCHEMA", "BundleContext", "bundle_bytes", "cell_document", "recipe_document"]

SCHEMA = "slabcell.bundle/1"
PNG_LEVEL = 1  # the picture is noise to the compressor: a higher level costs time and gains little

Pixels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
Rows = Mapping[str, Sequence[Mapping[str, object]]]


def recipe_document(recipe: Recipe) -> dict[str, object]:
    """Return a recipe as JSON knows it, its template included."""
    return {
        "schema": "slabcell.recipe/1",
        "name": recipe.name,
        "thickness_mm": recipe.thickness_mm,
        "other_thickness_mm": {str(slot): height for slot, height in recipe.other_thickness_mm.items()},
        "template": {
            "name": recipe.template.name,
            "sha256": recipe.template.sha256,
            "slots": [polygon.vertices.tolist() for polygon in recipe.template.slots],
        },
        "segmentation": recipe.segmentation.model_dump(mode="json"),
        "matching": recipe.matching.model_dump(mode="json"),
        "grasp": recipe.grasp.model_dump(mode="json"),
        "gates": recipe.gates.model_dump(mode="json"),
        "blobs": recipe.blobs.model_dump(mode="json"),
    }


def cell_document(settings: CellSettings, arm: ArmModel) -> dict[str, object]:
    """Return what of the cell decides on the poses."""
    return {
        "schema": "slabcell.cell/1",
        "arm": arm.name,
        "pick_base": settings.pick_base.as_tuple(),
        "place_base": settings.place_base.as_tuple(),
        "tool": settings.tool.as_tuple(),
        "pick_area": settings.pick_area.vertices.tolist(),
        "forbidden": [zone.vertices.tolist() for zone in settings.forbidden],
        "gripper_radius_mm": settings.gripper_radius_mm,
        "approach_mm": settings.approach_mm,
        "tolerance_mm": settings.tolerance_mm,
        "tolerance_deg": settings.tolerance_deg,
    }


class BundleContext:
    """What is the same in every bundle of a run, made once."""

    def __init__(self, recipe: Recipe, calibration: Calibration, settings: CellSettings, arm: ArmModel) -> None:
        self.recipe = recipe
        self.settings = settings
        self.files = {
            "recipe.json": _json(recipe_document(recipe)),
            "calibration.json": _json(calibration_document(calibration)),
            "cell.json": _json(cell_document(settings, arm)),
        }


def bundle_bytes(
    cycle: CycleRecord,
    pixels: Pixels | None,
    context: BundleContext,
    rows: Rows,
    created: str,
    *,
    pause: Callable[[], None] = lambda: None,
) -> bytes:
    """Return the zip file of one cycle.  ``pause`` is called between its parts, and may take its time."""
    files = {**context.files, "ledger.json": _json({"schema": "slabcell.ledger/1", **rows})}
    pause()
    files["transcript.json"] = _json(_transcript(cycle))
    pause()
    files["telegrams.json"] = _json(cycle.telegrams)
    if cycle.result is not None:
        pause()
        files["result.json"] = _json(cycle.result.to_document("frame.png"))
        pause()
        files["overlay.json"] = _json(overlay_document(cycle.result, "frame.png"))
    pause()
    if cycle.verification and cycle.placements:
        report = AsBuilt.of(context.recipe.template.slots, cycle.placements, context.settings)
        files["as-built.json"] = _json(report.to_document(cycle.job_id, context.recipe.name))
        files["as-built.csv"] = report.to_csv().encode()
        files["as-built.svg"] = report.to_svg().encode()
    if pixels is not None:
        pause()
        encoded, png = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
        if not encoded:
            msg = f"picture of shape {pixels.shape}, {pixels.dtype} cannot be written as PNG"
            raise ValueError(msg)
        files["frame.png"] = png.tobytes()
    manifest = {
        "schema": SCHEMA,
        "created": created,
        "cycle": cycle.cycle_id,
        "job": cycle.job_id,
        "session": cycle.session,
        "trigger_sequence": cycle.trigger_sequence,
        "verification": cycle.verification,
        "code": cycle.code,
        "message": cycle.message,
        "free_slots": list(cycle.free_slots),
        "laid_slots": list(cycle.laid_slots),
        "correction_mm": cycle.correction_mm,
        "timing_ms": {stage: round(value, 3) for stage, value in cycle.times_ms.items()},
        "refused": [{"slot": item.slot, "number": int(item.fault), "detail": item.detail} for item in cycle.refused],
        "offers": [
            {
                "result_id": offer.result_id,
                "slot": offer.slot,
                "score": offer.score,
                "pick": offer.pick.as_tuple(),
                "place": offer.place.as_tuple(),
            }
            for offer in cycle.offers
        ],
        "placements": [_finite(asdict(item)) for item in cycle.placements],
        "versions": _versions(),
        "files": sorted(files),
    }
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in {"manifest.json": _json(manifest), **files}.items():
            pause()
            how = zipfile.ZIP_STORED if name.endswith(".png") else zipfile.ZIP_DEFLATED
            archive.writestr(name, content, compress_type=how)
    return stream.getvalue()


def _transcript(cycle: CycleRecord) -> list[dict[str, object]]:
    """Return requests and answers as JSON knows them; made here, because the robot waits where they are noted."""
    return [{"request": asdict(request), "answer": asdict(answer)} for request, answer in cycle.transcript]


def _finite(values: dict[str, object]) -> dict[str, object]:
    """Write what could not be measured as null: JSON knows no NaN."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in values.items()
    }


@cache
def _versions() -> dict[str, str]:
    """Return what ran; looking it up reads files."""
    return {
        "slabcell": version("slabcell"),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "opencv": version("opencv-python-headless"),
    }


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1, allow_nan=False) + "\n").encode()
