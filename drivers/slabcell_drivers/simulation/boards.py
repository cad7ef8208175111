"""What does the camera see of a calibration board, and where are boards held to calibrate well?"""

import cv2
import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.protocol import Pixels
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.simulation.exposure import FINE, add_blurred, cover_fine, fine_window
from slabcell_drivers.simulation.formats import digitise
from slabcell_drivers.simulation.projection import Projector
from slabcell_drivers.simulation.rendering import bare_table
from slabcell_drivers.simulation.scene import BoardSpec, CameraSpec, Optics, Scene
from slabcell_drivers.simulation.surfaces import light_field

__all__ = ["board_corners", "camera_views", "plane_views", "render_board"]

Points = npt.NDArray[np.float64]


def render_board(
    camera: CameraSpec, optics: Optics, board: BoardSpec, pose: Frame, *, seed: int = 0, frame_number: int = 0
) -> Pixels:
    """Return the picture of a board whose frame (see `BoardSpec`) is at ``pose`` in the root, shape (height, width)."""
    projector = Projector(camera, FINE)
    image = bare_table(camera, optics, (), seed)
    plane = pose.matrix
    white = [projector.contour(_rectangle(*_rim(board)), plane)]
    black = [projector.contour(square, plane) for square in _squares(board)]
    window = fine_window(white, camera.width, camera.height, optics.blur_sigma_px)
    if window is not None:
        fine = cover_fine(white, window)
        fine *= np.float32(board.white_dn - optics.table_dn)
        fine += cover_fine(black, window) * np.float32(board.black_dn - board.white_dn)
        add_blurred(image, window, fine, optics.blur_sigma_px)
    image *= light_field(camera.width, camera.height, optics.unevenness, seed)
    return digitise(image, optics, (seed, frame_number))


def board_corners(camera: CameraSpec, board: BoardSpec, pose: Frame) -> Points:
    """Return the true pixels of the inner corners, shape (rows·columns, 2), along the rows first."""
    i, j = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    flat = np.column_stack([i.ravel(), j.ravel()]) * board.pitch_mm
    solid = flat @ pose.matrix[:3, :2].T + pose.matrix[:3, 3]
    return Projector(camera).pixels(solid)


def camera_views(scene: Scene, seed: int = 0, count: int = 15) -> tuple[Frame, ...]:
    """Return poses of the board, in the root, that calibrate the lens well: tilted, near and far, all over the view.

    Near ones are in the middle of the picture, others at its rim, with at least half of their white margin in view.
    """
    random = np.random.default_rng([seed, 5])
    camera, board = scene.camera, scene.board
    middle = np.array([board.columns - 1, board.rows - 1]) * board.pitch_mm / 2
    found: list[Frame] = []
    while len(found) < count:
        index = len(found)
        distance = camera.frame.z_mm * random.uniform(*((0.6, 0.72) if index % 9 == 4 else (0.78, 0.95)))
        u = camera.width * (0.5 + 0.4 * ((index % 3) - 1) + random.uniform(-0.06, 0.06))
        v = camera.height * (0.5 + 0.4 * ((index // 3 % 3) - 1) + random.uniform(-0.06, 0.06))
        lean, towards = np.deg2rad(random.uniform(12.0, 35.0)), random.uniform(0, 2 * np.pi)
        axis = np.array([np.cos(towards), np.sin(towards), 0.0]) * lean
        lying = _rotation(axis) @ _rotation(np.array([0.0, 0.0, random.uniform(-0.3, 0.3)]))
        facing = lying @ np.diag([1.0, -1.0, -1.0])  # the printed face looks into the camera
        for shrink in np.linspace(1.0, 0.0, 41):  # towards the middle of the view until all of the board is seen
            centre = np.array(
                [
                    (camera.width / 2 + shrink * (u - camera.width / 2) - camera.cx_px) / camera.fx_px * distance,
                    (camera.height / 2 + shrink * (v - camera.height / 2) - camera.cy_px) / camera.fy_px * distance,
                    distance,
                ]
            )
            seen = np.eye(4)
            seen[:3, :3] = facing
            seen[:3, 3] = centre - facing @ (middle[0], middle[1], 0.0)
            pose = Frame.from_matrix(camera.frame.matrix @ seen)
            if _inside(camera, board, pose):
                found.append(pose)
                break
    return tuple(found)


def plane_views(scene: Scene, count: int = 5, *, thickness_mm: float | None = None) -> tuple[Frame, ...]:
    """Return poses of the board lying on the table, in the root; the first has the table frame's origin and axes.

    There its inner corner (0, 0) is above the origin, its rows run along X; the others are spread over the view.
    ``thickness_mm`` takes the place of the board's own.
    """
    camera, board = scene.camera, scene.board
    height = board.thickness_mm if thickness_mm is None else thickness_mm
    table = scene.table.frame
    poses = [table @ Frame(z_mm=height)]
    middle = Frame(-(board.columns - 1) * board.pitch_mm / 2, -(board.rows - 1) * board.pitch_mm / 2)
    spots = [(0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9), (0.5, 0.5), (0.5, 0.1), (0.5, 0.9), (0.1, 0.5)]
    for index in range(count - 1):
        share_u, share_v = spots[index % len(spots)]
        turn = (12.0, 95.0, -20.0, 50.0, 170.0, -80.0, 30.0, 140.0)[index % len(spots)] + 7.0 * (index // len(spots))
        for shrink in np.linspace(1.0, 0.0, 41):
            spot = (
                camera.width * (0.5 + shrink * (share_u - 0.5)),
                camera.height * (0.5 + shrink * (share_v - 0.5)),
            )
            x, y = _on_plane(camera, spot, table.z_mm + height)
            pose = Frame(x, y, table.z_mm + height, turn) @ middle
            if _inside(camera, board, pose):
                poses.append(pose)
                break
    return tuple(poses)


def _rotation(axis: Points) -> Points:
    matrix, _ = cv2.Rodrigues(axis)
    return np.asarray(matrix, np.float64)


def _on_plane(camera: CameraSpec, pixel: tuple[float, float], height_mm: float) -> tuple[float, float]:
    """Return where the ray of a pixel, distortion left aside, meets a level plane of the root."""
    ray = np.array([(pixel[0] - camera.cx_px) / camera.fx_px, (pixel[1] - camera.cy_px) / camera.fy_px, 1.0])
    direction = camera.frame.matrix[:3, :3] @ ray
    centre = camera.frame.matrix[:3, 3]
    point = centre + direction * ((height_mm - centre[2]) / direction[2])
    return float(point[0]), float(point[1])


def _inside(camera: CameraSpec, board: BoardSpec, pose: Frame) -> bool:
    """Tell whether all squares and half of the margin are in the picture."""
    left, low, right, high = _rim(board)
    half = board.margin_mm / 2
    print_ = _rectangle(left + half, low + half, right - half, high - half)
    pixels = Projector(camera).pixels(print_ @ pose.matrix[:3, :2].T + pose.matrix[:3, 3])
    return bool(np.all(pixels > 0) and np.all(pixels < (camera.width - 1, camera.height - 1)))


def _rim(board: BoardSpec) -> tuple[float, float, float, float]:
    border = board.pitch_mm + board.margin_mm
    return -border, -border, (board.columns - 1) * board.pitch_mm + border, (board.rows - 1) * board.pitch_mm + border


def _squares(board: BoardSpec) -> list[Points]:
    pitch = board.pitch_mm
    return [
        _rectangle((i - 1) * pitch, (j - 1) * pitch, i * pitch, j * pitch)
        for i in range(board.columns + 1)
        for j in range(board.rows + 1)
        if (i + j) % 2 == 0
    ]


def _rectangle(left: float, low: float, right: float, high: float) -> Points:
    return np.array([[left, low], [right, low], [right, high], [left, high]])
