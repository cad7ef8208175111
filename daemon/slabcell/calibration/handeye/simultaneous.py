"""Where does the camera sit, rotation and translation found together?  Andreff-Horaud-Espiau and Daniilidis.

Both solve A·X = X·B for relative motions A of the hand and B of the board as the camera sees it.

Sources: N. Andreff, R. Horaud, B. Espiau, "On-line hand-eye calibration", 3DIM 1999; K. Daniilidis, "Hand-eye
calibration using dual quaternions", IJRR 18(3), 1999.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from slabcell.calibration.handeye.motion import Array, hat, nearest_rotation, rigid
from slabcell.calibration.handeye.separate import park, translation_of

__all__ = ["andreff", "daniilidis"]


def andreff(a: Array, b: Array) -> Array:
    """Return X (4, 4) from pairs (m, 4, 4): one linear system in the nine numbers of R and the three of t."""
    length = _length(a, b)
    turn_a, shift_a = a[:, :3, :3], a[:, :3, 3] / length
    turn_b, shift_b = b[:, :3, :3], b[:, :3, 3] / length
    count = len(a)
    rows = np.zeros((count, 12, 12))
    rows[:, :9, :9] = np.eye(9) - np.einsum("nij,nkl->nikjl", turn_a, turn_b).reshape(count, 9, 9)
    for axis in range(3):
        rows[:, 9 + axis, 3 * axis : 3 * axis + 3] = shift_b
    rows[:, 9:, 9:] = np.eye(3) - turn_a
    right = np.concatenate([np.zeros((count, 9)), shift_a], axis=1)
    normal: Array = np.asarray(np.einsum("nji,njk->ik", rows, rows), np.float64)
    solution: Array = np.asarray(
        np.linalg.pinv(normal, hermitian=True) @ np.einsum("nji,nj->i", rows, right), np.float64
    )
    matrix = solution[:9].reshape(3, 3)
    scale = np.cbrt(np.linalg.det(matrix))
    if abs(scale) < 1e-9:
        return park(a, b)
    return translation_of(nearest_rotation(matrix / scale), a, b)


def daniilidis(a: Array, b: Array) -> Array:
    """Return X (4, 4) from pairs (m, 4, 4): the dual quaternion in the null space of all screw equations.

    The null space has two dimensions, and a quadratic equation picks the unit dual quaternion in it.  Both roots are
    tried against the pairs: taking the wrong one is what makes this method fail now and then by decimetres.
    """
    length = _length(a, b)
    real_a, dual_a = _dual_quaternions(a, length)
    real_b, dual_b = _dual_quaternions(b, length)
    count = len(a)
    rows = np.zeros((count, 6, 8))
    rows[:, :3, 0] = real_a[:, 1:] - real_b[:, 1:]
    rows[:, :3, 1:4] = hat(real_a[:, 1:] + real_b[:, 1:])
    rows[:, 3:, 0] = dual_a[:, 1:] - dual_b[:, 1:]
    rows[:, 3:, 1:4] = hat(dual_a[:, 1:] + dual_b[:, 1:])
    rows[:, 3:, 4] = rows[:, :3, 0]
    rows[:, 3:, 5:8] = rows[:, :3, 1:4]
    _, _, vt = np.linalg.svd(rows.reshape(-1, 8), full_matrices=False)
    u1, v1, u2, v2 = vt[6, :4], vt[6, 4:], vt[7, :4], vt[7, 4:]
    found: list[Array] = []
    for share in _roots(float(u1 @ v1), float(u1 @ v2 + u2 @ v1), float(u2 @ v2)):
        square = share**2 * float(u1 @ u1) + 2.0 * share * float(u1 @ u2) + float(u2 @ u2)
        if square > 1e-12:
            real = (share * u1 + u2) / np.sqrt(square)
            dual = (share * v1 + v2) / np.sqrt(square)
            shift = 2.0 * _vector_of_product(dual, real) * length
            turn = np.asarray(Rotation.from_quat(real[[1, 2, 3, 0]]).as_matrix(), np.float64)
            found.append(rigid(turn, shift))
    if not found:
        return park(a, b)
    return min(found, key=lambda x: float(np.linalg.norm((a @ x - x @ b)[:, :3] / (1.0, 1.0, 1.0, length))))


def _length(a: Array, b: Array) -> float:
    """Return a length in mm that makes translations comparable to rotations."""
    shifts = np.concatenate([a[:, :3, 3], b[:, :3, 3]])
    return max(float(np.sqrt((shifts * shifts).sum(axis=1).mean())), 1e-6)


def _dual_quaternions(motions: Array, length: float) -> tuple[Array, Array]:
    """Return real and dual parts (m, 4), scalar first, with a scalar that is not negative."""
    real = np.asarray(Rotation.from_matrix(motions[:, :3, :3]).as_quat(), np.float64)[:, [3, 0, 1, 2]]
    real *= np.where(real[:, :1] < 0.0, -1.0, 1.0)
    shift = motions[:, :3, 3] / length
    scalar = -0.5 * (shift * real[:, 1:]).sum(axis=1)
    vector = 0.5 * (real[:, :1] * shift + np.cross(shift, real[:, 1:]))
    return real, np.column_stack([scalar, vector])


def _vector_of_product(dual: Array, real: Array) -> Array:
    """Return the vector part of dual · conjugate(real)."""
    return real[0] * dual[1:] - dual[0] * real[1:] - np.cross(dual[1:], real[1:])


def _roots(a: float, b: float, c: float) -> list[float]:
    if abs(a) < 1e-15:
        return [] if abs(b) < 1e-15 else [-c / b]
    # Noise may make the discriminant slightly negative where both roots coincide.
    root = np.sqrt(max(b * b - 4.0 * a * c, 0.0))
    return [(-b + root) / (2.0 * a), (-b - root) / (2.0 * a)]
