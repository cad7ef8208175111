"""Where do camera and board sit, found together?  Shah and Li-Wang-Wu solve A·X = Z·B for both unknowns.

Sources: M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product", ASME JMR 5(3),
2013; A. Li, L. Wang, D. Wu, "Simultaneous robot-world and hand-eye calibration using dual-quaternions and Kronecker
product", Int. J. Physical Sciences 5(10), 2010.
"""

import numpy as np

from slabcell.calibration.handeye.motion import Array, nearest_rotation, rigid

__all__ = ["li", "shah"]


def shah(a: Array, b: Array) -> tuple[Array, Array]:
    """Return X and Z, each (4, 4), from stations (n, 4, 4): rotations from the singular vectors of one 9x9 matrix."""
    turn_a, turn_b = a[:, :3, :3], b[:, :3, :3]
    # vec(Ra·X·Rbᵀ) = (Ra ⊗ Rb)·vec(X) with rows stacked; summed over the stations it is n·vec(Z).
    total = np.einsum("nij,nkl->ikjl", turn_a, turn_b).reshape(9, 9)
    u, _, vt = np.linalg.svd(total)
    x, z = vt[0].reshape(3, 3), u[:, 0].reshape(3, 3)
    sign = 1.0 if np.linalg.det(x) > 0.0 else -1.0
    turn_x, turn_z = nearest_rotation(sign * x), nearest_rotation(sign * z)
    rows = np.concatenate([turn_a, np.broadcast_to(-np.eye(3), turn_a.shape)], axis=2).reshape(-1, 6)
    right = (b[:, :3, 3] @ turn_z.T - a[:, :3, 3]).ravel()
    shift = np.asarray(np.linalg.lstsq(rows, right, rcond=None)[0], np.float64)
    return rigid(turn_x, shift[:3]), rigid(turn_z, shift[3:])


def li(a: Array, b: Array) -> tuple[Array, Array]:
    """Return X and Z, each (4, 4), from stations (n, 4, 4): one linear system in all 24 numbers."""
    shifts = np.concatenate([a[:, :3, 3], b[:, :3, 3]])
    length = max(float(np.sqrt((shifts * shifts).sum(axis=1).mean())), 1e-6)
    count = len(a)
    turn_a, turn_b = a[:, :3, :3], b[:, :3, :3]
    rows = np.zeros((count, 12, 24))
    rows[:, :9, :9] = np.einsum("nij,kl->nikjl", turn_a, np.eye(3)).reshape(count, 9, 9)
    rows[:, :9, 9:18] = -np.einsum("ij,nlk->nikjl", np.eye(3), turn_b).reshape(count, 9, 9)
    for axis in range(3):
        rows[:, 9 + axis, 9 + 3 * axis : 12 + 3 * axis] = b[:, :3, 3] / length
    rows[:, 9:, 18:21] = -turn_a
    rows[:, 9:, 21:24] = np.eye(3)
    right = np.concatenate([np.zeros((count, 9)), a[:, :3, 3] / length], axis=1)
    solution = np.asarray(np.linalg.lstsq(rows.reshape(-1, 24), right.ravel(), rcond=None)[0], np.float64)
    turn_x, turn_z = nearest_rotation(solution[:9].reshape(3, 3)), nearest_rotation(solution[9:18].reshape(3, 3))
    return rigid(turn_x, length * solution[18:21]), rigid(turn_z, length * solution[21:])
