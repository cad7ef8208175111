"""Where does the camera sit, rotation found first and translation after it?  Tsai-Lenz, Park-Martin, Horaud.

All solve A·X = X·B for relative motions A of the hand and B of the board as the camera sees it.  They resist noise of
the robot's translation, and suffer from noise of its rotation.

Sources: R. Tsai, R. Lenz, "A new technique for fully autonomous and efficient 3D robotics hand/eye calibration", IEEE
T-RA 5(3), 1989; F. Park, B. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group", IEEE T-RA
10(5), 1994; R. Horaud, F. Dornaika, "Hand-eye calibration", IJRR 14(3), 1995.
"""

import numpy as np

from slabcell.calibration.handeye.motion import Array, hat, nearest_rotation, rigid, rotation_log

__all__ = ["horaud", "park", "translation_of", "tsai"]


def tsai(a: Array, b: Array) -> Array:
    """Return X (4, 4) from pairs (m, 4, 4): the rotation by a linear system in modified Rodrigues vectors.

    The vectors are infinite where X turns by 180°, as that of a camera looking down on an arm does.  So the board's
    side is turned by half a turn about each axis as well, and the system whose X turns least is taken.
    """
    found: list[tuple[float, Array]] = []
    for half_turn in np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]):
        turn_a = _half_sines(rotation_log(a[:, :3, :3]))
        turn_b = _half_sines(rotation_log(b[:, :3, :3])) * half_turn
        solution = _least_squares(hat(turn_a + turn_b).reshape(-1, 3), (turn_b - turn_a).ravel())
        square = float(solution @ solution)
        vector = 2.0 * solution / np.sqrt(1.0 + square)
        rotation = (1.0 - vector @ vector / 2.0) * np.eye(3) + 0.5 * (
            np.outer(vector, vector) + np.sqrt(4.0 - vector @ vector) * hat(vector)
        )
        found.append((square, nearest_rotation(rotation) * half_turn))
    return translation_of(min(found, key=lambda item: item[0])[1], a, b)


def park(a: Array, b: Array) -> Array:
    """Return X (4, 4) from pairs (m, 4, 4): the rotation that carries the logarithms onto each other best."""
    turn_a, turn_b = rotation_log(a[:, :3, :3]), rotation_log(b[:, :3, :3])
    return translation_of(nearest_rotation(turn_a.T @ turn_b), a, b)


def horaud(a: Array, b: Array) -> Array:
    """Return X (4, 4) from pairs (m, 4, 4): the unit quaternion that carries the axes onto each other best."""
    axis_a, axis_b = _axes(rotation_log(a[:, :3, :3])), _axes(rotation_log(b[:, :3, :3]))
    # Quaternion q with axis_a·q = q·axis_b: the smallest eigenvector of the squared difference of both products.
    left, right = _left_product(axis_a), _right_product(axis_b)
    difference = left - right
    _, vectors = np.linalg.eigh(np.einsum("nij,nik->jk", difference, difference))
    w, x, y, z = vectors[:, 0]
    vector = np.array([x, y, z])
    rotation = (w * w - vector @ vector) * np.eye(3) + 2.0 * np.outer(vector, vector) + 2.0 * w * hat(vector)
    return translation_of(nearest_rotation(rotation), a, b)


def translation_of(rotation: Array, a: Array, b: Array) -> Array:
    """Return X (4, 4) with this rotation and the translation that satisfies A·X = X·B best."""
    rows = (a[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (b[:, :3, 3] @ rotation.T - a[:, :3, 3]).ravel()
    return rigid(rotation, _least_squares(rows, right))


def _least_squares(rows: Array, right: Array) -> Array:
    return np.asarray(np.linalg.lstsq(rows, right, rcond=None)[0], np.float64)


def _half_sines(turns: Array) -> Array:
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    return turns * np.where(angle > 1e-12, 2.0 * np.sin(angle / 2.0) / np.maximum(angle, 1e-12), 1.0)


def _axes(turns: Array) -> Array:
    angle = np.linalg.norm(turns, axis=1, keepdims=True)
    moved = angle[:, 0] > 1e-6
    return np.where(moved[:, None], turns / np.maximum(angle, 1e-12), 0.0)


def _left_product(vectors: Array) -> Array:
    matrix = np.zeros((len(vectors), 4, 4))
    matrix[:, 0, 1:] = -vectors
    matrix[:, 1:, 0] = vectors
    matrix[:, 1:, 1:] = hat(vectors)
    return matrix


def _right_product(vectors: Array) -> Array:
    matrix = np.zeros((len(vectors), 4, 4))
    matrix[:, 0, 1:] = -vectors
    matrix[:, 1:, 0] = vectors
    matrix[:, 1:, 1:] = -hat(vectors)
    return matrix
