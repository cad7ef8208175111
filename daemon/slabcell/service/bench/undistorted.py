"""What would a camera without distortion have seen?  A picture, and what was found in it, moved together."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.model import Lens
from slabcell.calibration.projection import normalized
from slabcell.geometry import Points

__all__ = ["undistorted_overlay", "undistorted_picture"]

Json = dict[str, Any]


def undistorted_picture(image: npt.NDArray[np.uint8], lens: Lens) -> npt.NDArray[np.uint8]:
    """Return the picture as a camera without distortion would have taken it, with the same matrix."""
    if lens.model == "fisheye":
        flat = cv2.fisheye.undistortImage(image, lens.matrix, lens.distortion, Knew=lens.matrix)
    else:
        flat = cv2.undistort(image, lens.matrix, lens.distortion)
    return np.asarray(flat, np.uint8)


def undistorted_overlay(located: Json, lens: Lens) -> Json:
    """Return parts and rejected blobs of a ``slabcell.locate/1`` object where they lie in the undistorted picture."""
    return {
        "schema": "slabcell.preview-undistorted/1",
        "parts": [_moved(part, lens) for part in located["parts"]],
        "rejected": [_moved(blob, lens) for blob in located["rejected"]],
    }


def _moved(item: Json, lens: Lens) -> Json:
    """Return an item with its outline and middle moved, and its angle as the picture shows it there."""
    image = item["image"]
    moved: Json = {**item, "outline_px": _rounded(_points(np.array(item["outline_px"], np.float64), lens))}
    if "angle_deg" not in image:
        (u, v) = _points(np.array([[image["u"], image["v"]]]), lens)[0]
        return {**moved, "image": {**image, "u": round(float(u), 2), "v": round(float(v), 2)}}
    angle = np.radians(-image["angle_deg"])  # counter-clockwise as people see it, while v points down
    ahead = [image["u"] + np.cos(angle), image["v"] + np.sin(angle)]
    (u, v), (u1, v1) = _points(np.array([[image["u"], image["v"]], ahead]), lens)
    turned = -float(np.degrees(np.arctan2(v1 - v, u1 - u)))
    return {**moved, "image": {"u": round(float(u), 2), "v": round(float(v), 2), "angle_deg": round(turned, 3)}}


def _points(pixels: Points, lens: Lens) -> Points:
    if len(pixels) == 0:
        return pixels
    ideal = normalized(pixels, lens)
    return (np.column_stack([ideal, np.ones(len(ideal))]) @ lens.matrix.T)[:, :2]


def _rounded(points: Points) -> list[list[float]]:
    return [[round(float(u), 2), round(float(v), 2)] for u, v in points]
