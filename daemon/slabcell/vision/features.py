"""What are blobs like, in millimetres of the table?  Their features, and filters and an order by any of them.

All but the holes come from the outline on the plane of the slabs' upper faces, so lens, perspective and height are
taken out.  The features of a blob say nothing of slots: that is matching.

Sources: M.-K. Hu, "Visual pattern recognition by moment invariants", IRE Information Theory 8(2), 1962; roundness and
convexity as in ISO 9276-6.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.geometry import Points
from slabcell.recipe import BlobFilter, BlobParameters
from slabcell.vision.plane import PlaneView

__all__ = ["BlobFeatures", "fails", "measure_blob", "order_of"]

# Smaller holes than this many pixels are noise.
MIN_HOLE_PX: Final = 9.0


@dataclass(frozen=True, slots=True)
class BlobFeatures:
    """One blob.  Lengths in mm, areas in mm², on the table; angles counter-clockwise from the table's X.

    ``area_mm2`` and ``perimeter_mm`` are those of the outline, holes not taken out; ``x_mm``, ``y_mm`` its centroid;
    ``orientation_deg`` the principal axis, above -90 and up to 90; ``elongation`` the root of the ratio of the
    principal moments.  ``inertia`` is the polar second moment over the squared area (1/2π for a disc, more else),
    ``inertia_major_mm4`` and ``inertia_minor_mm4`` the principal second moments.  ``x_min_mm`` ... ``y_max_mm`` is the
    bounding box along the table's axes, ``length_mm`` by ``width_mm`` the smallest turned one.  ``rectangularity``:
    share of that box which is filled; ``roundness``: 4π·area/perimeter²; ``convexity``: area over the hull's.
    ``hu``: the seven moment invariants of the area.  ``u``, ``v``: the centroid in the picture, in pixels.
    """

    u: float
    v: float
    area_mm2: float
    perimeter_mm: float
    x_mm: float
    y_mm: float
    orientation_deg: float
    elongation: float
    inertia: float
    inertia_major_mm4: float
    inertia_minor_mm4: float
    x_min_mm: float
    y_min_mm: float
    x_max_mm: float
    y_max_mm: float
    length_mm: float
    width_mm: float
    rectangularity: float
    roundness: float
    convexity: float
    holes: int
    hole_area_mm2: float
    hu: tuple[float, float, float, float, float, float, float]
    touches_border: bool

    def value(self, feature: str) -> float:
        """Return a feature by the name that recipes use: a field's, or hu1 ... hu7."""
        if feature.startswith("hu"):
            return self.hu[int(feature[2:]) - 1]
        return float(getattr(self, feature))

    def to_document(self) -> dict[str, object]:
        """Return the features as they stand in the result's JSON."""
        numbers = {
            name: round(self.value(name), 6) if name in ("inertia", "elongation") else round(self.value(name), 4)
            for name in self.__slots__
            if name not in ("u", "v", "hu", "touches_border", "holes")
        }
        return {
            "image": {"u": round(self.u, 3), "v": round(self.v, 3)},
            **numbers,
            "holes": self.holes,
            # Hu's moments span many powers of ten.
            "hu": [float(f"{value:.6g}") for value in self.hu],
            "touches_border": self.touches_border,
        }


def measure_blob(
    outline: Points, contour: Points, mask: npt.NDArray[np.uint8], plane: PlaneView, *, touches_border: bool
) -> BlobFeatures:
    """Return the features of one blob.

    ``outline`` (n, 2): its edge on the plane of the slabs' upper faces, mm; ``contour`` (m, 2): the same in the
    picture, through the centres of its outermost pixels; ``mask``: where it was found, for its holes.
    """
    middle = outline.mean(axis=0)
    ring = (outline - middle).astype(np.float32).reshape(-1, 1, 2)
    moments: dict[str, float] = cv2.moments(ring)  # pyright: ignore[reportAssignmentType] - its stub says Moments
    area = max(abs(moments["m00"]), 1e-9)
    sign = 1.0 if moments["m00"] >= 0 else -1.0
    xx, yy, xy = (sign * moments[name] for name in ("mu20", "mu02", "mu11"))
    spread = float(np.hypot(0.5 * (xx - yy), xy))
    # An outline of noise may cross itself, so that its inertia comes out negative.
    major, minor = (max(value, 1e-9) for value in (0.5 * (xx + yy) + spread, 0.5 * (xx + yy) - spread))
    perimeter = float(cv2.arcLength(ring, closed=True))
    hull = float(cv2.contourArea(np.asarray(cv2.convexHull(ring), np.float32)))
    _, (side, other), _ = cv2.minAreaRect(ring)
    length, width = max(side, other), min(side, other)
    x, y = middle + np.array([moments["m10"], moments["m01"]]) / (sign * area)
    low, high = outline.min(axis=0), outline.max(axis=0)
    count, hole_px = _holes(contour, mask)
    scale = plane.mm_per_px
    hu: Any = np.ravel(cv2.HuMoments(cv2.moments(ring))).tolist()
    centre: Points = plane.to_pixels(np.array([[x, y]], np.float64))[0]
    # -90 and 90 degrees are one axis: the positive one stands for it.
    axis = float(np.rad2deg(0.5 * np.arctan2(2.0 * xy, xx - yy)))
    return BlobFeatures(
        u=float(centre[0]),
        v=float(centre[1]),
        area_mm2=area,
        perimeter_mm=perimeter,
        x_mm=float(x),
        y_mm=float(y),
        orientation_deg=axis if axis > -90.0 else 90.0,
        elongation=float(np.sqrt(major / minor)),
        inertia=(xx + yy) / area**2,
        inertia_major_mm4=major,
        inertia_minor_mm4=minor,
        x_min_mm=float(low[0]),
        y_min_mm=float(low[1]),
        x_max_mm=float(high[0]),
        y_max_mm=float(high[1]),
        length_mm=float(length),
        width_mm=float(width),
        rectangularity=area / max(length * width, 1e-9),
        roundness=float(4.0 * np.pi * area / max(perimeter, 1e-9) ** 2),
        convexity=area / max(hull, 1e-9),
        holes=count,
        hole_area_mm2=hole_px * scale * scale,
        hu=tuple(hu),
        touches_border=touches_border,
    )


def _holes(contour: Points, mask: npt.NDArray[np.uint8]) -> tuple[int, float]:
    """Return how many holes a blob has, and how many pixels they have together."""
    left, top = np.maximum(np.floor(contour.min(axis=0)), 0).astype(int)
    right, bottom = np.ceil(contour.max(axis=0)).astype(int) + 1
    window = np.ascontiguousarray(mask[top:bottom, left:right])
    if window.size == 0:
        return 0, 0.0
    contours, found = cv2.findContours(window, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    if len(contours) == 0:
        return 0, 0.0
    tree = np.asarray(found, np.int32).reshape(-1, 4)
    # Of the outlines in the window the blob's own is the one that fills it; parts of neighbours are smaller.
    boxes = [cv2.boundingRect(item) for item in contours]
    sizes = [box[2] * box[3] if tree[index, 3] < 0 else -1 for index, box in enumerate(boxes)]
    own = int(np.argmax(sizes))
    pixels = [
        # Pick's theorem: the outline of a hole runs through the pixels around it.
        float(cv2.contourArea(item)) - 0.5 * len(item) + 1.0
        for index, item in enumerate(contours)
        if tree[index, 3] == own
    ]
    kept = [count for count in pixels if count >= MIN_HOLE_PX]
    return len(kept), sum(kept)


def fails(features: BlobFeatures, filters: Sequence[BlobFilter]) -> str:
    """Return why a blob does not pass the filters, or nothing."""
    for item in filters:
        value = features.value(item.feature)
        if item.min is not None and value < item.min:
            return f"{item.feature} is {value:.6g}, the recipe's filter wants at least {item.min:g}"
        if item.max is not None and value > item.max:
            return f"{item.feature} is {value:.6g}, the recipe's filter wants at most {item.max:g}"
    return ""


def order_of(features: Sequence[BlobFeatures], parameters: BlobParameters) -> list[int]:
    """Return the indices of the blobs in the recipe's order; as they are where it names none."""
    if parameters.sort_by is None:
        return list(range(len(features)))
    name, down = parameters.sort_by, parameters.sort_order == "descending"
    return sorted(range(len(features)), key=lambda index: features[index].value(name), reverse=down)
