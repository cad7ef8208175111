"""Pictures of boards whose truth is known: exact corners, exact lens, exact poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import CubicSpline

from slabcell.calibration import Board, Detection

Array = npt.NDArray[np.float64]

MATRIX = np.array([[1666.0, 0.0, 481.0], [0.0, 1665.0, 303.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.12, 0.15, 0.0006, -0.0004, 0.0])
SIZE = (960, 600)
BOARD = Board.parse("checkerboard:12x9:16")


@dataclass(frozen=True)
class View:
    """Board to camera, and the camera."""

    rotation: Array
    translation: Array
    matrix: Array = field(default_factory=lambda: MATRIX)
    distortion: Array = field(default_factory=lambda: DISTORTION)
    size: tuple[int, int] = SIZE

    def project(self, points: Array) -> Array:
        matrix, distortion = self.matrix, self.distortion
        turn, _ = cv2.Rodrigues(self.rotation)
        pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), turn, self.translation, matrix, distortion)
        return pixels.reshape(-1, 2)

    def board_at_pixels(self) -> Array:
        """Return x, y on the board's face for a grid of 3x3 samples in every pixel, shape (3h, 3w, 2)."""
        matrix, distortion = self.matrix, self.distortion
        width, height = self.size
        # The lens is smooth: undistort on a coarse net, and interpolate with splines.
        step = 20
        net_u, net_v = np.arange(-step, width + 2 * step, step, float), np.arange(-step, height + 2 * step, step, float)
        net = np.stack(np.meshgrid(net_u, net_v), axis=-1).reshape(-1, 1, 2)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        ideal = cv2.undistortPointsIter(net, matrix, distortion, np.eye(3), np.eye(3), stop).reshape(
            len(net_v), len(net_u), 2
        )
        rays = np.concatenate([ideal, np.ones((*ideal.shape[:2], 1))], axis=-1) @ self.rotation
        origin = -self.rotation.T @ self.translation
        coarse = origin[:2] + rays[..., :2] * (-origin[2] / rays[..., 2])[..., None]
        by_u = CubicSpline(net_u, np.eye(len(net_u)))((np.arange(3 * width) - 1.0) / 3.0)
        by_v = CubicSpline(net_v, np.eye(len(net_v)))((np.arange(3 * height) - 1.0) / 3.0)
        return np.stack([(by_v @ coarse[..., k] @ by_u.T).astype(np.float32) for k in (0, 1)], axis=-1)


def looking_down(
    x_mm: float,
    y_mm: float,
    turn_deg: float = 0.0,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    height_mm: float = 1040.0,
) -> View:
    """Return a view of a board whose middle is at x, y before the camera, turned and tilted."""
    a, b, c = np.deg2rad([turn_deg, *tilt_deg])
    z, _ = cv2.Rodrigues(np.array([0.0, 0.0, a]))
    y, _ = cv2.Rodrigues(np.array([0.0, b, 0.0]))
    x, _ = cv2.Rodrigues(np.array([c, 0.0, 0.0]))
    rotation = np.diag([1.0, -1.0, -1.0]) @ z @ y @ x
    return View(rotation, np.array([x_mm, y_mm, height_mm]) - rotation @ (88.0, 64.0, 0.0))


def tilted_views(count: int = 12, seed: int = 0) -> list[View]:
    """Return views all over the picture, tilted, as a lens calibration needs them."""
    random = np.random.default_rng(seed)
    views: list[View] = []
    while len(views) < count:
        n = len(views)
        x, y = 130.0 * (n % 3 - 1) + random.uniform(-20, 20), 80.0 * (n // 3 % 3 - 1) + random.uniform(-15, 15)
        tilt = tuple(random.uniform(12, 32, 2) * random.choice([-1, 1], 2))
        view = looking_down(x, y, random.uniform(-180, 180), tilt, random.uniform(750, 950))
        pixels = view.project(BOARD.points)
        if pixels.min() > 25 and pixels[:, 0].max() < SIZE[0] - 25 and pixels[:, 1].max() < SIZE[1] - 25:
            views.append(view)
    return views


def flat_views() -> list[View]:
    """Return views of the board lying in one plane, 1040 mm before a camera that looks straight down."""
    places = [
        (0.0, 0.0, 5.0),
        (-130.0, -70.0, 20.0),
        (130.0, -70.0, 100.0),
        (130.0, 70.0, -30.0),
        (-130.0, 70.0, 170.0),
    ]
    return [looking_down(*place) for place in places]


def seen(view: View, name: str = "view", board: Board = BOARD, noise_px: float = 0.03, seed: int = 0) -> Detection:
    """Return what a detector with this noise finds in a view."""
    points = board.points
    pixels = view.project(points) + np.random.default_rng(seed).normal(0.0, noise_px, (len(points), 2))
    return Detection(name, *view.size, np.arange(len(points)), points, pixels)


def render_checkerboard(
    board: Board, view: View, *, noise: float = 1.5, seed: int = 0, blur_px: float = 0.7
) -> npt.NDArray[np.uint8]:
    """Return the picture: dark square outward of the first corner, light margin of one square, grey table."""
    at = view.board_at_pixels() / board.pitch_mm
    i, j = np.floor(at[..., 0]).astype(int), np.floor(at[..., 1]).astype(int)
    grey = np.full(at.shape[:2], 90, np.float32)
    grey[(i >= -2) & (j >= -2) & (i <= board.columns) & (j <= board.rows)] = 215.0
    grey[(i >= -1) & (j >= -1) & (i < board.columns) & (j < board.rows) & ((i + j) % 2 == 0)] = 35.0
    small = cv2.GaussianBlur(cv2.resize(grey, view.size, interpolation=cv2.INTER_AREA), (0, 0), blur_px)
    small = small + np.random.default_rng(seed).normal(0.0, noise, small.shape)
    return np.clip(small.round(), 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def lab() -> SimpleNamespace:
    """Everything above, for tests."""
    return SimpleNamespace(
        BOARD=BOARD, MATRIX=MATRIX, DISTORTION=DISTORTION, SIZE=SIZE, View=View,
        looking_down=looking_down, tilted_views=tilted_views, flat_views=flat_views, seen=seen,
        render_checkerboard=render_checkerboard,
    )  # fmt: skip
