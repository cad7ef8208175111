"""What would the vision make of this picture with these parameters?  The result, and what it passed by."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.file import from_document as calibration_from_document
from slabcell.calibration.model import Calibration
from slabcell.cell.bundle_file import recipe_from_document
from slabcell.errors import ImageError
from slabcell.geometry import Points, Polygon
from slabcell.images import Image
from slabcell.service.bench.histogram import histogram_document
from slabcell.service.bench.undistorted import undistorted_overlay, undistorted_picture
from slabcell.service.bench.wire import Message
from slabcell.service.bench.work import Work
from slabcell.vision.blobs import RawBlob
from slabcell.vision.layers import LayeredLocator
from slabcell.vision.outlines import overlay_document
from slabcell.vision.pixels import as_8_bit
from slabcell.vision.trace import Trace, trace

__all__ = ["BUFFERS", "preview"]

MAX_SIDE_PX = 4096
PNG_LEVEL = 1

BUFFERS = {
    "input.png": "image/png",
    "undistorted.png": "image/png",
    "mask.png": "image/png",
    "blobs.png": "image/png",
    "contours.json": "application/json",
    "residuals.json": "application/json",
    "histogram.json": "application/json",
    "undistorted.json": "application/json",
}
"""What a preview leaves to look at, and its media type."""


def preview(work: Work) -> Message:
    """Return the located document, and the buffers as blobs; their names stand in the content, in the same order.

    With the argument ``buffers`` false there are none.
    """
    said = work.arguments
    recipe = recipe_from_document(said["recipe"])
    calibration = calibration_from_document(said["calibration"], "the calibration")
    image = work.picture()
    area = Polygon.from_points(said["area_mm"]) if said.get("area_mm") else None
    done = trace(LayeredLocator(calibration, recipe), image, area_mm=area, free_slots=said.get("free_slots"))
    height, width = image.shape[:2]
    step = -(-max(height, width) // MAX_SIDE_PX)
    located = None if done.result is None else overlay_document(done.result, said.get("name", "picture"))
    files: dict[str, bytes] = {}
    if said.get("buffers", True):
        files = _pictures(image, calibration, done, step)
        blobs = [_contour(number, blob) for number, blob in enumerate(done.blobs)]
        files["contours.json"] = _json({"schema": "slabcell.preview-contours/1", "blobs": blobs})
        files["residuals.json"] = _json({"schema": "slabcell.preview-residuals/1", "parts": _residuals(done)})
        files["histogram.json"] = _json(histogram_document(image, recipe.segmentation))
        if located is not None:
            files["undistorted.json"] = _json(undistorted_overlay(located, calibration.lens))
    content: dict[str, object] = {
        "located": located,
        "refusal": done.refusal,
        "segmentation": done.segmentation,
        "width": width,
        "height": height,
        "reduced": step,
        "buffers": list(files),
    }
    return Message(content, tuple(files.values()))


def _pictures(image: Image, calibration: Calibration, done: Trace, step: int) -> dict[str, bytes]:
    shown = as_8_bit(image) if image.ndim == 2 else _shallow(image)
    files = {
        "input.png": _png(shown[::step, ::step]),
        "undistorted.png": _png(undistorted_picture(shown, calibration.lens)[::step, ::step]),
    }
    if done.mask is not None:
        files["mask.png"] = _png(done.mask[::step, ::step])
        files["blobs.png"] = _png(_coloured(done)[::step, ::step])
    return files


def _shallow(image: Image) -> npt.NDArray[np.uint8]:
    return (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image.astype(np.uint8, copy=False)


def _coloured(done: Trace) -> npt.NDArray[np.uint8]:
    """Return the blobs, each filled with a colour of its own on black; neighbours in the list differ most."""
    mask = done.mask if done.mask is not None else np.zeros((1, 1), np.uint8)
    canvas = np.zeros((*mask.shape, 3), np.uint8)
    for number, blob in enumerate(done.blobs):
        hue = round(number * 180 * 0.618) % 180
        pixel = cv2.cvtColor(np.array([[[hue, 170, 235]]], np.uint8), cv2.COLOR_HSV2BGR)
        blue, green, red = (int(value) for value in np.asarray(pixel).reshape(3))
        cv2.fillPoly(canvas, [np.rint(blob.outline).astype(np.int32).reshape(-1, 1, 2)], (blue, green, red))
    return canvas


def _contour(number: int, blob: RawBlob) -> dict[str, object]:
    return {
        "blob": number,
        "area_px": round(blob.area_px, 1),
        "touches_rim": blob.touches_rim,
        "outline_px": _rounded(blob.polygon),
    }


def _residuals(done: Trace) -> list[dict[str, object]]:
    return [
        {
            "slot": item.slot,
            "pixels": _rounded(item.pixels),
            "outward_mm": [
                round(float(value), 4) if found else None
                for value, found in zip(item.outward_mm, item.valid, strict=True)
            ],
        }
        for item in done.residuals
    ]


def _rounded(points: Points) -> list[list[float]]:
    return [[round(float(u), 2), round(float(v), 2)] for u, v in points]


def _png(picture: npt.NDArray[Any]) -> bytes:
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(picture), [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not done:
        msg = f"a buffer of shape {picture.shape} could not be encoded"
        raise ImageError(msg)
    return encoded.tobytes()


def _json(content: dict[str, object]) -> bytes:
    return json.dumps(content, allow_nan=False).encode()
