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
ENOUGH = 0.9
"""Of all corners: with fewer the picture is tried with more contrast, enlarged, and as a negative."""
MAX_ENLARGED_SIDE = 6000


def find_charuco(grey: Grey, board: Board) -> Found | None:
    """Return the corners found and their numbers on the board; None if fewer than six are seen."""
    dictionary = cv2.aruco.getPredefinedDictionary(int(getattr(cv2.aruco, f"DICT_{board.dictionary}")))
    shape = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, board.marker_mm, dictionary)
    shape.setLegacyPattern(board.legacy)
    numbers, pixels = _detect(shape, grey, enough=ENOUGH * len(board.points))
    if len(numbers) < MIN_POINTS:
        return None
    columns, rows = board.grid
    # OpenCV counts rows downwards as the board is printed; our frame has Y up, so that Z points out of the face.
    down, right = np.divmod(numbers, columns)
    indices = (rows - 1 - down) * columns + right
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


def _detect(shape: cv2.aruco.CharucoBoard, grey: Grey, enough: float) -> tuple[npt.NDArray[np.int64], Points]:
    """Return numbers (n,) and pixels (n, 2) of the corners, from whichever way of looking shows most of them."""
    numbers, pixels = _look(shape, grey)
    if len(numbers) >= enough:
        return numbers, pixels
    low, high = np.percentile(grey, (1.0, 99.0))
    stretched = np.clip((grey - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
    size = (2 * grey.shape[1], 2 * grey.shape[0])
    for enlarge, negative in ((False, False), (True, False), (False, True)):
        if enlarge and max(size) > MAX_ENLARGED_SIDE:
            continue
        seen = (
            np.asarray(cv2.resize(stretched, size, interpolation=cv2.INTER_CUBIC), np.uint8) if enlarge else stretched
        )
        more, places = _look(shape, np.asarray(cv2.bitwise_not(seen), np.uint8) if negative else seen)
        if len(more) > len(numbers):
            numbers, pixels = more, (places + 0.5) / 2.0 - 0.5 if enlarge else places
        if len(numbers) >= enough:
            break
    return numbers, pixels


def _look(shape: cv2.aruco.CharucoBoard, grey: Grey) -> tuple[npt.NDArray[np.int64], Points]:
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(shape).detectBoard(grey)
    # detectBoard returns None for both where it finds nothing, which its type stub does not say.
    if cast("npt.NDArray[np.generic] | None", numbers) is None:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    return np.asarray(numbers, np.int64).ravel(), np.asarray(corners, np.float64).reshape(-1, 2)
