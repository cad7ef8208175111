"""Where are the circles of an asymmetric grid?  Centres of the dark discs, and what perspective does to them.

The centre of a disc's picture is not the picture of its centre: `disc_shift` gives the difference, once lens and pose
are known roughly, so that calibrations can take it off.
"""

import cv2
import numpy as np

from slabcell.calibration.boards import Board
from slabcell.calibration.corners import Found, Grey
from slabcell.calibration.model import Lens
from slabcell.calibration.projection import Vector, project
from slabcell.geometry import Points

__all__ = ["disc_shift", "find_circles"]

RIM_POINTS = 32


def find_circles(grey: Grey, board: Board) -> Found | None:
    """Return the centres of all circles of the grid, dark on light or light on dark; None if it is not found whole."""
    return _find_dark(grey, board) or _find_dark(np.asarray(cv2.bitwise_not(grey), np.uint8), board)


def _find_dark(grey: Grey, board: Board) -> Found | None:
    detector = _disc_detector(grey)
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID
    for extra in (0, cv2.CALIB_CB_CLUSTERING):
        found, centres = cv2.findCirclesGrid(
            grey, (board.columns, board.rows), flags=flags | extra, blobDetector=detector
        )
        if found:
            grid = np.asarray(centres, np.float64).reshape(board.rows, board.columns, 2)
            along, across = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
            if along[0] * across[1] - along[1] * across[0] > 0.0:
                grid = grid[::-1]  # rows downwards, as OpenCV draws its boards; ours go up
            pixels = _balance(grey, grid)
            return Found(np.arange(board.rows * board.columns), ((0, pixels),))
    return None


def _disc_detector(grey: Grey) -> cv2.SimpleBlobDetector:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea = 20.0
    parameters.maxArea = 0.02 * grey.size
    parameters.minDistBetweenBlobs = 4.0
    parameters.filterByCircularity = False
    parameters.filterByConvexity = True
    parameters.minConvexity = 0.9
    parameters.filterByInertia = True
    parameters.minInertiaRatio = 0.15
    return cv2.SimpleBlobDetector.create(parameters)


def _balance(grey: Grey, grid: Points) -> Points:
    """Return the centres (n, 2) of darkness around each centre of a grid (rows, columns, 2), background taken off."""
    flat = grid.reshape(-1, 2)
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    radius = max(float(apart.min()) * 0.5, 3.0)
    refined = flat.copy()
    for n, (u, v) in enumerate(flat):
        left, right = max(int(u - radius), 0), min(int(u + radius) + 2, grey.shape[1])
        top, bottom = max(int(v - radius), 0), min(int(v + radius) + 2, grey.shape[0])
        patch = grey[top:bottom, left:right].astype(np.float64)
        rows, columns = np.mgrid[top:bottom, left:right].astype(np.float64)
        near = np.hypot(columns - u, rows - v) <= radius
        bright, dark = np.percentile(patch[near], 90), np.percentile(patch[near], 5)
        if bright - dark < 10.0:
            continue
        # A tenth of the contrast is cut off at either end, so that noise of paper and print weighs nothing.
        weight = np.clip(((bright - patch) / (bright - dark) - 0.1) / 0.8, 0.0, 1.0) * near
        refined[n] = (weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()
    return refined


def disc_shift(points_mm: Points, diameter_mm: float, pose: Vector, lens: Lens) -> Points:
    """Return by how many pixels (n, 2) the centre of each disc's picture lies off the picture of its centre."""
    angles = np.linspace(0.0, 2.0 * np.pi, RIM_POINTS, endpoint=False)
    rim = 0.5 * diameter_mm * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(RIM_POINTS)])
    outline = project((points_mm[:, None] + rim).reshape(-1, 3), pose, lens)[0].reshape(-1, RIM_POINTS, 2)
    middle = project(points_mm, pose, lens)[0]
    x, y = np.moveaxis(outline - middle[:, None], -1, 0)
    cross = x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y
    area = 3.0 * cross.sum(axis=1)
    return np.column_stack(
        [
            ((x + np.roll(x, -1, axis=1)) * cross).sum(axis=1) / area,
            ((y + np.roll(y, -1, axis=1)) * cross).sum(axis=1) / area,
        ]
    )
