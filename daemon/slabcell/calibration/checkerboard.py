"""Where are the inner corners of a checkerboard, and which of them is the first?

The corners are found on a reduced picture, which is fast, and refined on the full one.
"""

import cv2
import numpy as np

from slabcell.calibration.boards import Board
from slabcell.calibration.corners import MIN_WINDOW, Found, Grey, refine_corners, step_px
from slabcell.geometry import Points

__all__ = ["find_checkerboard", "number_grid"]

REDUCED_SIDE = 960
"""Long side in pixels of the picture that is searched first."""
MAX_SEARCH_SIDE = 2600
"""Long side in pixels of the largest picture that is searched."""
MIN_SHARE = 0.7
"""Of the corners that must be found for sure; with fewer something else is wrong."""
SECTOR_SEARCH_SIDE = 1300
"""Long side in pixels of the picture that is searched by sectors first."""


def find_checkerboard(grey: Grey, board: Board) -> Found | None:
    """Return the inner corners, without a few that are covered; None if the board is not seen whole."""
    columns, rows = board.grid
    coarse = _search(grey, columns, rows)
    if coarse is None:
        return None
    corners = number_grid(grey, coarse.reshape(rows, columns, 2)).reshape(-1, 2)
    kept, variants = refine_corners(grey, board.points, corners, step_px(board.points, corners, board.pitch_mm))
    if len(kept) < MIN_SHARE * len(corners):
        return None
    note = (
        "its squares are so small that the sub-pixel search has next to nothing to go by"
        if variants[0][0] <= MIN_WINDOW
        else ""
    )
    return Found(kept, variants, note)


def _search(grey: Grey, columns: int, rows: int) -> Points | None:
    size = (columns, rows)
    # The search by squares first, which is the fastest by far where the board is plain to see; on a full picture of
    # another board it takes minutes.  The one by sectors needs no light margin, and bears noise and covered corners.
    attempts = (
        lambda: _by_squares(grey, size, cv2.CALIB_CB_FAST_CHECK),
        lambda: _by_sectors(grey, size, SECTOR_SEARCH_SIDE, 0),
        lambda: _by_sectors(grey, size, SECTOR_SEARCH_SIDE, cv2.CALIB_CB_NORMALIZE_IMAGE),
        lambda: _by_sectors(grey, size, SECTOR_SEARCH_SIDE, cv2.CALIB_CB_EXHAUSTIVE),
        lambda: _by_sectors(grey, size, MAX_SEARCH_SIDE, 0),
        lambda: _by_squares(grey, size, 0),
    )
    return next((corners for attempt in attempts if (corners := attempt()) is not None), None)


def _by_squares(grey: Grey, size: tuple[int, int], extra: int) -> Points | None:
    small, scale = _reduced(grey, REDUCED_SIDE)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | extra
    found, corners = cv2.findChessboardCorners(small, size, flags=flags)
    return _enlarged(np.asarray(corners, np.float64).reshape(-1, 2), scale) if found else None


def _by_sectors(grey: Grey, size: tuple[int, int], side: int, flags: int) -> Points | None:
    if side > SECTOR_SEARCH_SIDE >= max(grey.shape):
        return None  # that picture was searched already
    small, scale = _reduced(grey, side)
    found, corners = cv2.findChessboardCornersSB(small, size, flags=flags)
    return _enlarged(np.asarray(corners, np.float64).reshape(-1, 2), scale) if found else None


def _reduced(grey: Grey, side: int) -> tuple[Grey, float]:
    scale = max(grey.shape) / side
    if scale <= 1.0:
        return grey, 1.0
    size = (round(grey.shape[1] / scale), round(grey.shape[0] / scale))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8), grey.shape[1] / size[0]


def _enlarged(corners: Points, scale: float) -> Points:
    return (corners + 0.5) * scale - 0.5


def number_grid(grey: Grey, grid: Points) -> Points:
    """Return the grid (rows, columns, 2) turned so that it is numbered as the board's frame demands.

    Rows and columns turn counter-clockwise as the picture is seen (Z of the board points at the camera), and the square
    diagonally outward of the first corner is dark.  A board that looks the same after half a turn starts at the
    candidate further left in the picture.
    """
    along = grid[0, -1] - grid[0, 0]
    across = grid[-1, 0] - grid[0, 0]
    if along[0] * across[1] - along[1] * across[0] > 0.0:
        grid = grid[::-1]
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2 == 0:
        turn = (grid[0, 0, 0], -grid[0, 0, 1]) > (grid[-1, -1, 0], -grid[-1, -1, 1])
    else:
        turn = _outer_square_contrast(grey, grid) > 0.0
    return np.ascontiguousarray(grid[::-1, ::-1] if turn else grid)


def _outer_square_contrast(grey: Grey, grid: Points) -> float:
    """Return how much brighter the squares are whose colour is that of the first corner's outer square."""
    rows, columns = grid.shape[:2]
    centres = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4.0
    u = np.clip(centres[..., 0].round().astype(int), 0, grey.shape[1] - 1)
    v = np.clip(centres[..., 1].round().astype(int), 0, grey.shape[0] - 1)
    values = grey[v, u].astype(np.float64)
    j, i = np.indices((rows - 1, columns - 1))
    # The inner square at the first corner touches the outer one diagonally, so they have the same colour.
    same = (i + j) % 2 == 0
    return float(values[same].mean() - values[~same].mean())
