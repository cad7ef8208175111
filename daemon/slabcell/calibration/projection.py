"""How does a picture point move when a lens or a pose changes?  Projection with its derivatives, for every lens model.

Intrinsics are one vector: fx, fy, cx, cy, then the distortion coefficients in OpenCV's order.  Poses are one vector of
six: rotation vector, translation (board or table to camera, mm).
"""

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.model import Lens
from slabcell.geometry import Points

__all__ = ["Vector", "board_pose", "from_vector", "normalized", "parameter_names", "project", "rms_length", "to_vector"]

Vector = npt.NDArray[np.float64]

BROWN_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")


def rms_length(rows: Points) -> float:
    """Return the root of the mean squared length of the rows, shape (n, 2)."""
    return float(np.sqrt((rows * rows).sum(axis=1).mean()))


def parameter_names(lens: Lens) -> tuple[str, ...]:
    """Return the names of the intrinsics in the order of `to_vector`."""
    names = ("k1", "k2", "k3", "k4") if lens.model == "fisheye" else BROWN_NAMES[: lens.distortion.size]
    return ("fx", "fy", "cx", "cy", *names)


def to_vector(lens: Lens) -> Vector:
    """Return the intrinsics as one vector."""
    m = lens.matrix
    return np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], lens.distortion.ravel()])


def from_vector(vector: Vector, model: Lens) -> Lens:
    """Return the lens of a vector of intrinsics; ``model`` tells which model."""
    fx, fy, cx, cy = vector[:4]
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Lens(matrix, np.array(vector[4:], dtype=np.float64), model.model)


def project(points_mm: Points, pose: Vector, lens: Lens) -> tuple[Points, Points, Points]:
    """Return pixels (n, 2) and their derivatives to the pose (2n, 6) and to the intrinsics (2n, k)."""
    solid = np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 1, 3)
    turn, shift = np.ascontiguousarray(pose[:3]), np.ascontiguousarray(pose[3:])
    if lens.model == "fisheye":
        pixels, jacobian = cv2.fisheye.projectPoints(solid, turn, shift, lens.matrix, lens.distortion)
        j = np.asarray(jacobian, np.float64)
        return np.asarray(pixels, np.float64).reshape(-1, 2), j[:, 8:14], j[:, :8]
    pixels, jacobian = cv2.projectPoints(solid, turn, shift, lens.matrix, lens.distortion)
    j = np.asarray(jacobian, np.float64)
    return np.asarray(pixels, np.float64).reshape(-1, 2), j[:, :6], j[:, 6 : 10 + lens.distortion.size]


def normalized(pixels: Points, lens: Lens) -> Points:
    """Return the directions (n, 2), X/Z and Y/Z in the camera's frame, in which pixels (n, 2) are seen."""
    points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    if lens.model == "fisheye":
        ideal = cv2.fisheye.undistortPoints(points, lens.matrix, lens.distortion)
    else:
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
        ideal = cv2.undistortPointsIter(points, lens.matrix, lens.distortion, np.eye(3), np.eye(3), stop)
    return np.asarray(ideal, np.float64).reshape(-1, 2)


def board_pose(points_mm: Points, pixels: Points, lens: Lens) -> Vector:
    """Return the pose of a flat board (board to camera) that explains the pixels best, lens given."""
    flat = np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 1, 3)
    ideal = normalized(pixels, lens).reshape(-1, 1, 2)
    _, turns, shifts, _ = cv2.solvePnPGeneric(flat, ideal, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    turn, shift = cv2.solvePnPRefineLM(flat, ideal, np.eye(3), np.zeros(5), turns[0], shifts[0])
    pose = np.concatenate([np.asarray(turn, np.float64).ravel(), np.asarray(shift, np.float64).ravel()])
    for _ in range(5):  # polish in pixels, where the noise is even
        seen, j, _ = project(points_mm, pose, lens)
        step, *_ = np.linalg.lstsq(j, (pixels - seen).ravel(), rcond=None)
        pose = pose + step
        if float(np.abs(step).max()) < 1e-9:
            break
    return pose
