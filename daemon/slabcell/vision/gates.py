"""Can a picture be used at all?  Light, sharpness, and whether rim and marks of the table are where they should be.

A picture that fails is not located in, because what would be found in it could be wrong: an `UnusableImageError` names
every gate that failed with what was measured and the limit.
"""

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from slabcell.errors import ImageError
from slabcell.geometry import Points, Polygon
from slabcell.recipe import GateParameters
from slabcell.vision.edge_profile import ProfileModel
from slabcell.vision.edge_projection import Poses
from slabcell.vision.edges import cut_edges
from slabcell.vision.kernel import engine, maps_of
from slabcell.vision.outline_set import OutlineSet
from slabcell.vision.pixels import Grey
from slabcell.vision.plane import PlaneView
from slabcell.vision.result import GateReading
from slabcell.vision.survey import Survey, lightest_of, step_of

__all__ = ["UnusableImageError", "blur_gate", "light_gates", "reference_gates", "require"]

# IMAGE_UNUSABLE in the error catalogue.
NUMBER: Final = 1501
# Corners of the polygon that stands for a round mark.
CIRCLE_CORNERS = 48
# How far from its place rim or mark is looked for.
REACH_PX = 9.0


class UnusableImageError(ImageError):
    """A picture failed a gate.  ``readings`` are those of all gates that were looked at."""

    def __init__(self, readings: tuple[GateReading, ...]) -> None:
        failed = [item.detail for item in readings if not item.passed]
        super().__init__("the picture cannot be used: " + "; ".join(failed), number=NUMBER)
        self.readings = readings


def require(readings: tuple[GateReading, ...]) -> None:
    """Raise UnusableImageError unless every gate was passed."""
    if not all(item.passed for item in readings):
        raise UnusableImageError(readings)


def light_gates(grey: Grey, surveyed: Survey, parameters: GateParameters) -> tuple[GateReading, ...]:
    """Return brightness and over-exposure of a picture; ``surveyed``: its survey with 8 bits."""
    if grey.dtype == np.uint8:
        lightest = surveyed.lightest
        saturated = 100.0 * int(surveyed.grey[-1]) / int(surveyed.grey.sum())
    else:
        sample = np.ascontiguousarray(grey[:: step_of(grey), :: step_of(grey)])
        lightest = lightest_of(np.bincount(sample.reshape(-1) >> 8, minlength=256).astype(np.int64))
        saturated = 100.0 * int(np.count_nonzero(sample == np.iinfo(grey.dtype).max)) / sample.size
    # That of the lightest half percent.
    brightest = 100.0 * lightest / 255.0
    return (
        GateReading(
            "brightness",
            brightest,
            parameters.min_brightness_percent,
            "%",
            brightest >= parameters.min_brightness_percent,
            f"too dark: its lightest pixels reach {brightest:.1f} % of full scale,"
            f" {parameters.min_brightness_percent:g} % are needed; check light, exposure and lens cap",
        ),
        GateReading(
            "overexposed",
            saturated,
            parameters.max_overexposed_percent,
            "%",
            saturated <= parameters.max_overexposed_percent,
            f"over-exposed: {saturated:.0f} % of its pixels are saturated,"
            f" {parameters.max_overexposed_percent:g} % are allowed; shorten the exposure",
        ),
    )


def blur_gate(surveyed: Survey, contrast: float, parameters: GateParameters) -> tuple[GateReading, ...]:
    """Return how blurred the sharpest edges are; nothing where there is no contrast to judge by.

    A step of this contrast, blurred by a Gaussian of width s, is nowhere steeper than contrast/(s·√(2π)).
    """
    if contrast <= 0.0 or surveyed.sharpest is None:
        return ()
    # A step is taken over two pixels.
    blur = contrast / (max(0.5 * surveyed.sharpest, 1e-3) * math.sqrt(2.0 * math.pi))
    return (
        GateReading(
            "blur",
            blur,
            parameters.max_blur_px,
            "px",
            blur <= parameters.max_blur_px,
            f"blurred: its sharpest edges are {blur:.1f} px wide, {parameters.max_blur_px:g} px are allowed;"
            " check focus, and that nothing moves",
        ),
    )


def reference_gates(grey: Grey, plane: PlaneView, parameters: GateParameters) -> tuple[GateReading, ...]:
    """Return how much of the table's rim and marks is seen, and how far it is from its place.

    ``plane`` is the work plane, z = 0.
    """
    shapes = [Polygon.from_points(_circle(mark.x_mm, mark.y_mm, mark.diameter_mm)) for mark in parameters.marks]
    if parameters.rim_mm is not None:
        shapes.append(Polygon.from_points(parameters.rim_mm))
    outlines = [cut_edges(shape, plane.mm_per_px) for shape in shapes]
    kept = [index for index, item in enumerate(outlines) if len(item)]
    if not kept:
        return ()
    wanted = OutlineSet.of([shapes[index] for index in kept], [outlines[index] for index in kept])
    none = np.zeros(len(kept))
    poses = Poses(none, wanted.pivots, wanted.pivots, none)
    edges = engine().project(wanted.whole, maps_of(plane, wanted, wanted.pivots), poses, mirrored=plane.mirrored)
    shifts = engine().measure_edges(grey, edges.lines, ProfileModel(1.0, REACH_PX, 1.0, 0.3))
    seen = 100.0 * float(np.mean(shifts.valid))
    readings = [
        GateReading(
            "reference_seen",
            seen,
            parameters.min_reference_percent,
            "%",
            seen >= parameters.min_reference_percent,
            f"rim and marks of the table: {seen:.0f} % of them are seen, {parameters.min_reference_percent:g} % are"
            " needed; something obstructs the view, or the camera has moved",
        )
    ]
    if np.count_nonzero(shifts.valid) >= 4:
        moved = _movement(edges.rows[shifts.valid], (shifts.shift / edges.px_per_mm)[shifts.valid])
        readings.append(
            GateReading(
                "reference_shift",
                moved,
                parameters.max_reference_shift_mm,
                "mm",
                moved <= parameters.max_reference_shift_mm,
                f"rim and marks of the table are {moved:.2f} mm from their places,"
                f" {parameters.max_reference_shift_mm:g} mm are allowed; the camera has moved: calibrate again",
            )
        )
    return tuple(readings)


def _movement(rows: npt.NDArray[np.float64], distance: npt.NDArray[np.float64]) -> float:
    """Return the length of the common shift that explains the distances along their normals."""
    directions = rows[:, :2]
    weight = np.ones(len(distance))
    shift: npt.NDArray[Any] = np.zeros(2)
    for _ in range(5):
        normal = directions.T @ (weight[:, None] * directions) + 1e-9 * np.eye(2)
        shift = np.linalg.solve(normal, directions.T @ (weight * distance))
        remaining = np.abs(distance - directions @ shift)
        weight = 1.0 / np.maximum(remaining, 0.1)
    return float(np.hypot(shift[0], shift[1]))


def _circle(x_mm: float, y_mm: float, diameter_mm: float) -> Points:
    angle = np.arange(CIRCLE_CORNERS) * (2.0 * np.pi / CIRCLE_CORNERS)
    return np.array([x_mm, y_mm]) + 0.5 * diameter_mm * np.column_stack([np.cos(angle), np.sin(angle)])
