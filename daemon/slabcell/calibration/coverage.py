"""Which part of the picture did the board's points cover?  Where they did not, a lens model is a guess."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.detection import Detection

__all__ = ["Coverage", "measure_coverage"]

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
