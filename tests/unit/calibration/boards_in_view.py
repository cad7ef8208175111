"""Pictures of boards whose truth is known: exact corners, exact lens, exact poses."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from scipy.interpolate import CubicSpline

from slabcell.calibration import Board

Array = npt.NDArray[np.float64]

MATRIX = np.array([[3333.0, 0.0, 962.0], [0.0, 3331.0, 605.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.15, 0.0006, -0.0004, 0.0])
SIZE = (1920, 1200)


@dataclass(frozen=True)
class View:
    """Board to camera, and the camera."""

    rotation: Array
    translation: Array
    matrix: Array = None  # type: ignore[assignment]
    distortion: Array = None  # type: ignore[assignment]
    size: tuple[int, int] = SIZE

    def lens(self) -> tuple[Array, Array]:
        return (MATRIX if self.matrix is None else self.matrix, DISTORTION if self.distortion is None else self.distortion)

    def project(self, points: Array) -> Array:
        matrix, distortion = self.lens()
        turn, _ = cv2.Rodrigues(self.rotation)
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), turn, self.translation, matrix, distortion)
        return pixels.reshape(-1, 2)

    def board_at_pixels(self) -> Array:
        """Return x, y on the board's face for a grid of 3x3 samples in every pixel, shape (3h, 3w, 2)."""
        matrix, distortion = self.lens()
        width, height = self.size
        # The lens is smooth: undistort on a coarse net, and interpolate with splines.
        step = 20
        net_u, net_v = np.arange(-step, width + 2 * step, step, float), np.arange(-step, height + 2 * step, step, float)
        net = np.stack(np.meshgrid(net_u, net_v), axis=-1).reshape(-1, 1, 2)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        ideal = cv2.undistortPointsIter(net, matrix, distortion, np.eye(3), np.eye(3), stop).reshape(len(net_v), len(net_u), 2)
        rays = np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1) @ self.rotation
        origin = -self.rotation.T @ self.translation
        coarse = origin[:2] + rays[..., :2] * (-origin[2] / rays[..., 2])[..., None]
        by_u = CubicSpline(net_u, np.eye(len(net_u)))((np.arange(3 * width) - 1.0) / 3.0)
        by_v = CubicSpline(net_v, np.eye(len(net_v)))((np.arange(3 * height) - 1.0) / 3.0)
        return np.stack([(by_v @ coarse[..., k] @ by_u.T).astype(np.float32) for k in (0, 1)], axis=-1)


def looking_down(x_mm: float, y_mm: float, turn_deg: float = 0.0, tilt: tuple[float, float] = (0.0, 0.0), height_mm: float = 1040.0) -> View:
    """Return a view of a board whose middle is near x, y before the camera, turned and tilted (deg)."""
    a, b, c = np.deg2rad([turn_deg, *tilt])
    z, _ = cv2.Rodrigues(np.array([0.0, 0.0, a]))
    y, _ = cv2.Rodrigues(np.array([0.0, b, 0.0]))
    x, _ = cv2.Rodrigues(np.array([c, 0.0, 0.0]))
    rotation = np.diag([1.0, -1.0, -1.0]) @ z @ y @ x
    return View(rotation, np.array([x_mm, y_mm, height_mm]) - rotation @ (88.0, 64.0, 0.0))


def render_checkerboard(board: Board, view: View, *, noise: float = 1.5, seed: int = 0, blur_px: float = 0.7) -> npt.NDArray[np.uint8]:
    """Return the picture: dark square outward of the first corner, light margin of one square, grey table."""
    at = view.board_at_pixels() / board.pitch_mm
    i, j = np.floor(at[..., 0]).astype(int), np.floor(at[..., 1]).astype(int)
    grey = np.full(at.shape[:2], 90, np.float32)
    paper = (i >= -2) & (j >= -2) & (i <= board.columns) & (j <= board.rows)
    squares = (i >= -1) & (j >= -1) & (i < board.columns) & (j < board.rows)
    grey[paper] = 215.0
    grey[squares & ((i + j) % 2 == 0)] = 35.0
    width, height = view.size
    small = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), blur_px)
    small = small + np.random.default_rng(seed).normal(0.0, noise, small.shape)
    return np.clip(small.round(), 0, 255).astype(np.uint8)
