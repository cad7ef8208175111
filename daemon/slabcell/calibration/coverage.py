"""Which part of the picture did the board's points cover?  Where they did not, a lens model is a guess."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.detection import Detection

__all__ = ["Coverage", "draw_coverage", "measure_coverage"]

CELLS_ACROSS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """How the points of all views are spread.

    ``hull_fraction``: part of the picture inside the convex hull of all points.  ``reach_fraction``: distance of the
    outermost point from the picture's centre, relative to the half diagonal.  ``counts``: points in each cell of a
    grid over the picture, shape (rows, columns).
    """

    width: int
    height: int
    hull_fraction: float
    reach_fraction: float
    counts: npt.NDArray[np.int64]

    def to_document(self) -> dict[str, object]:
        """Return the coverage as JSON values: ``counts`` row by row, cells of equal size over the whole picture."""
        return {
            "width": self.width,
            "height": self.height,
            "hull_fraction": self.hull_fraction,
            "reach_fraction": self.reach_fraction,
            "counts": self.counts.tolist(),
        }

    def warnings(self) -> list[str]:
        """Return what a person should do about it, in words."""
        lines: list[str] = []
        if self.hull_fraction < 0.6:
            lines.append(
                f"the views cover {self.hull_fraction:.0%} of the picture; show the board near "
                f"{self._emptiest()} as well, or do not trust positions there"
            )
        return lines

    def _emptiest(self) -> str:
        rows, columns = self.counts.shape
        top, left = self.counts[: rows // 2], slice(0, columns // 2)
        bottom, right = self.counts[rows // 2 :], slice(columns // 2, columns)
        quarters = {
            "the upper left": top[:, left].sum(),
            "the upper right": top[:, right].sum(),
            "the lower left": bottom[:, left].sum(),
            "the lower right": bottom[:, right].sum(),
        }
        return min(quarters, key=lambda name: quarters[name])


def measure_coverage(detections: Sequence[Detection]) -> Coverage:
    """Return how the points of the views are spread over the picture."""
    width, height = detections[0].width, detections[0].height
    pixels = np.vstack([d.pixels for d in detections])
    hull = cv2.convexHull(pixels.astype(np.float32).reshape(-1, 1, 2))
    centre = np.array([(width - 1) / 2.0, (height - 1) / 2.0])
    reach = float(np.linalg.norm(pixels - centre, axis=1).max() / np.hypot(*centre))
    rows = max(round(CELLS_ACROSS * height / width), 2)
    counts, _, _ = np.histogram2d(
        pixels[:, 1], pixels[:, 0], bins=(rows, CELLS_ACROSS), range=((-0.5, height - 0.5), (-0.5, width - 0.5))
    )
    return Coverage(width, height, float(cv2.contourArea(hull)) / (width * height), reach, counts.astype(np.int64))


def draw_coverage(
    coverage: Coverage, residuals: npt.NDArray[np.float64], width_px: int = 1200
) -> npt.NDArray[np.uint8]:
    """Return a picture of the points, (h, w, 3) uint8 BGR, each with its residual as a stroke a hundred times enlarged.

    ``residuals`` (n, 4): u, v and what is left in u and v.  Empty cells of the grid are shaded.
    """
    scale = width_px / coverage.width
    picture = np.full((max(round(coverage.height * scale), 1), width_px, 3), 255, np.uint8)
    rows, columns = coverage.counts.shape
    for row, column in np.argwhere(coverage.counts == 0):
        corner = (round(column * width_px / columns), round(row * picture.shape[0] / rows))
        opposite = (round((column + 1) * width_px / columns), round((row + 1) * picture.shape[0] / rows))
        cv2.rectangle(picture, corner, opposite, (225, 225, 245), cv2.FILLED)
    points = np.round(residuals[:, :2] * scale * 16.0).astype(np.int32)
    tips = np.round((residuals[:, :2] + 100.0 * residuals[:, 2:]) * scale * 16.0).astype(np.int32)
    hull = cv2.convexHull(points.reshape(-1, 1, 2))
    cv2.polylines(picture, [hull], isClosed=True, color=(170, 120, 60), thickness=2, lineType=cv2.LINE_AA, shift=4)
    for point, tip in zip(points.tolist(), tips.tolist(), strict=True):
        cv2.line(picture, point, tip, (60, 60, 200), 1, cv2.LINE_AA, 4)
        cv2.circle(picture, point, 24, (60, 140, 40), cv2.FILLED, cv2.LINE_AA, 4)
    return picture
