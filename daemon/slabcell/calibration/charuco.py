"""Where are the corners of a ChArUco board?  Its markers tell which corner is which, so a part of it is enough."""

from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.boards import Board
from slabcell.calibration.corners import Found, Grey, refine_corners, step_px
from slabcell.geometry import Points

__all__ = ["find_charuco"]

MIN_POINTS = 6


def find_charuco(grey: Grey, board: Board) -> Found | None:
    """Return the corners found and their numbers on the board; None if fewer than six are seen."""
    dictionary = cv2.aruco.getPredefinedDictionary(int(getattr(cv2.aruco, f"DICT_{board.dictionary}")))
    shape = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, board.marker_mm, dictionary)
    shape.setLegacyPattern(board.legacy)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(shape).detectBoard(grey)
    # detectBoard returns None for both where it finds nothing, which its type stub does not say.
    found = cast("npt.NDArray[np.generic] | None", numbers)
    if found is None or len(found) < MIN_POINTS:
        return None
    columns, rows = board.grid
    # OpenCV counts rows downwards as the board is printed; our frame has Y up, so that Z points out of the face.
    down, right = np.divmod(np.asarray(numbers, np.int64).ravel(), columns)
    indices = (rows - 1 - down) * columns + right
    pixels: Points = np.asarray(corners, np.float64).reshape(-1, 2)
    order = np.argsort(indices)
    indices, pixels = indices[order], pixels[order]
    points = board.points[indices]
    if np.linalg.matrix_rank(points[:, :2] - points[0, :2], tol=0.1 * board.pitch_mm) < 2:
        return None  # corners on one line tell nothing
    # The window may reach as far as the markers in the white squares, not into them.
    gap = (board.pitch_mm - board.marker_mm) / 2.0 / board.pitch_mm
    step = step_px(points, pixels, board.pitch_mm)
    kept, variants = refine_corners(grey, points, pixels, step, widest=0.95 * gap)
    return Found(indices[kept], variants) if len(kept) >= MIN_POINTS else None
