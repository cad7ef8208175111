"""How is a cycle kept, so that it can be looked at and run again?  One zip file: picture, parameters, result, record.

Written by a thread of its own, outside of the way from trigger to answer; a bundle appears complete or not at all.
What cannot be written is counted and reported: it never stops the cell.

========================  ==============================================================================
``manifest.json``         ``slabcell.bundle/1``: cycle, times, versions, and the names of the other files
``frame.png``             the picture, lossless
``recipe.json``           template and parameters as they were used
``calibration.json``      ``slabcell.calibration/1``
``result.json``           ``slabcell.locate/1``
``ledger.json``           what the ledger holds of the job when the cycle ended
``transcript.json``       the requests of the robot and the answers to them
========================  ==============================================================================
"""

from __future__ import annotations

import asyncio
import json
import os
import platform
import zipfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import structlog

from slabcell.calibration.file import to_document as calibration_document
from slabcell.calibration.model import Calibration
from slabcell.cell.events import CycleRecord
from slabcell.cell.executor import end_executor
from slabcell.recipe import Recipe

__all__ = ["SCHEMA", "BundleWriter", "bundle_bytes", "recipe_document"]

SCHEMA = "slabcell.bundle/1"
MAX_WAITING = 8
"""Bundles that may wait for the disk: each holds a picture in memory."""

PNG_LEVEL = 1  # the picture is noise to the compressor: a higher level costs time and gains little

Rows = Mapping[str, Sequence[Mapping[str, object]]]


def recipe_document(recipe: Recipe) -> dict[str, object]:
    """Return a recipe as JSON knows it, its template included."""
    return {
        "schema": "slabcell.recipe/1",
        "name": recipe.name,
        "thickness_mm": recipe.thickness_mm,
        "template": {
            "name": recipe.template.name,
            "sha256": recipe.template.sha256,
            "slots": [polygon.vertices.tolist() for polygon in recipe.template.slots],
        },
        "segmentation": recipe.segmentation.model_dump(mode="json"),
        "matching": recipe.matching.model_dump(mode="json"),
        "grasp": recipe.grasp.model_dump(mode="json"),
    }


def bundle_bytes(
    cycle: CycleRecord, pixels: np.ndarray | None, recipe: Recipe, calibration: Calibration, rows: Rows, created: str
) -> bytes:
    """Return the zip file of one cycle."""
    files: dict[str, bytes] = {
        "recipe.json": _json(recipe_document(recipe)),
        "calibration.json": _json(calibration_document(calibration)),
        "ledger.json": _json({"schema": "slabcell.ledger/1", **rows}),
        "transcript.json": _json(cycle.transcript),
    }
    if cycle.result is not None:
        files["result.json"] = _json(cycle.result.to_document("frame.png"))
    if pixels is not None:
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
        "timing_ms": {stage: round(value, 3) for stage, value in cycle.times_ms.items()},
        "refused": [{"slot": item.slot, "number": int(item.fault), "detail": item.detail} for item in cycle.refused],
        "offers": [{**asdict(offer), "state": offer.state.value} for offer in cycle.offers],
        "placements": [asdict(item) for item in cycle.placements],
        "versions": {
            "slabcell": version("slabcell"),
            "python": platform.python_version(),
            "numpy": version("numpy"),
            "opencv": cv2.__version__,
        },
        "files": sorted(files),
    }
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in {"manifest.json": _json(manifest), **files}.items():
            how = zipfile.ZIP_STORED if name.endswith(".png") else zipfile.ZIP_DEFLATED
            archive.writestr(name, content, compress_type=how)
    return stream.getvalue()


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1, allow_nan=True) + "\n").encode()


class BundleWriter:
    """Keeps bundles in a directory, which it creates.  ``failed`` is told why one could not be kept."""

    def __init__(self, directory: Path, *, failed: Callable[[str], None] | None = None) -> None:
        self.directory = directory
        self.failed = failed
        self.dropped = 0
        self._waiting = 0
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="slabcell-bundle")
        self._log = structlog.stdlib.get_logger("slabcell.bundle")

    def keep(self, cycle: CycleRecord, recipe: Recipe, calibration: Calibration, rows: Rows) -> None:
        """Have a finished cycle written; returns at once.  Called in the event loop."""
        if self._waiting >= MAX_WAITING:
            self.dropped += 1
            self._report(f"{self._waiting} bundles wait for the disk; {self.dropped} not kept so far")
            return
        created = datetime.now(UTC)
        kind = "verification" if cycle.verification else "cycle"
        name = f"{created:%Y%m%dT%H%M%S}.{created.microsecond // 1000:03d}Z_job{cycle.job_id}"
        path = self.directory / f"{name}_{cycle.session}-{cycle.trigger_sequence}_{kind}.zip"
        pixels = cycle.frame.pixels if cycle.frame is not None else None

        def write() -> None:
            content = bundle_bytes(cycle, pixels, recipe, calibration, rows, created.isoformat(timespec="milliseconds"))
            self.directory.mkdir(parents=True, exist_ok=True)
            temporary = path.with_suffix(".part")
            try:
                with temporary.open("wb") as stream:
                    stream.write(content)
                    stream.flush()
                    os.fsync(stream.fileno())
                temporary.replace(path)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise

        self._waiting += 1
        future = asyncio.get_running_loop().run_in_executor(self._writer, write)
        future.add_done_callback(self._written)

    def _written(self, future: asyncio.Future[None]) -> None:
        self._waiting -= 1
        error = future.exception()
        if error is not None:
            self.dropped += 1
            self._report(f"{self.directory}: {type(error).__name__}: {error}")

    def _report(self, detail: str) -> None:
        self._log.warning("bundle not kept", detail=detail)
        if self.failed is not None:
            self.failed(detail)

    async def close(self) -> None:
        """Wait for what is being written, and end the thread; may be called twice."""
        await end_executor(self._writer)
        await asyncio.sleep(0)  # lets the callbacks of the last bundles run
