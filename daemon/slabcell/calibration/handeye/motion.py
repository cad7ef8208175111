"""How are rigid motions in space computed with?  Batches of homogeneous matrices, their logarithms and adjoints.

A motion is a matrix of shape (..., 4, 4); a twist is (..., 6): rotation vector in rad first, then translation in mm.
Source: K. Lynch, F. Park, "Modern Robotics", chapter 3.
"""

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

__all__ = [
    "Array",
    "adjoint",
    "hat",
    "inverse",
    "kuka_matrix",
    "motion_exp",
    "motion_log",
    "nearest_rotation",
    "relative_motions",
    "rigid",
    "rotation_log",
]

Array = npt.NDArray[np.float64]

MAX_PAIRS = 3000


def hat(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) that take the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)


def rigid(rotation: Array, translation: Array) -> Array:
    """Return the motion of a rotation (..., 3, 3) and a translation (..., 3)."""
    rotation, translation = np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    motion = np.zeros((*rotation.shape[:-2], 4, 4))
    motion[..., :3, :3] = rotation
    motion[..., :3, 3] = translation
    motion[..., 3, 3] = 1.0
    return motion


def inverse(motions: Array) -> Array:
    """Return the motions that undo these."""
    turned = np.swapaxes(motions[..., :3, :3], -1, -2)
    return rigid(turned, -np.einsum("...ij,...j->...i", turned, motions[..., :3, 3]))


def rotation_log(rotations: Array) -> Array:
    """Return the rotation vectors (n, 3), in rad, of rotations (n, 3, 3)."""
    return np.asarray(Rotation.from_matrix(rotations).as_rotvec(), np.float64)


def motion_log(motions: Array) -> Array:
    """Return the twists (n, 6) of motions (n, 4, 4) whose rotations are well below half a turn."""
    turn = rotation_log(motions[:, :3, :3])
    angle = np.linalg.norm(turn, axis=1)
    cross = hat(turn)
    square = np.square(angle)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    factor = np.where(small, 1.0 / 12.0 + square / 720.0, (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / np.square(safe))
    left = np.eye(3) - 0.5 * cross + factor[:, None, None] * (cross @ cross)
    return np.column_stack([turn, np.einsum("nij,nj->ni", left, motions[:, :3, 3])])


def motion_exp(twist: Array) -> Array:
    """Return the motion (4, 4) of one twist (6,)."""
    turn = np.asarray(twist[:3], np.float64)
    angle = float(np.linalg.norm(turn))
    cross = hat(turn)
    if angle < 1e-6:
        left = np.eye(3) + 0.5 * cross
    else:
        left = (
            np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * (cross @ cross)
        )
    return rigid(np.asarray(Rotation.from_rotvec(turn).as_matrix(), np.float64), left @ twist[3:])


def adjoint(motions: Array) -> Array:
    """Return the matrices (..., 6, 6) that carry twists along: M·exp(ξ) = exp(Ad ξ)·M."""
    rotation, translation = motions[..., :3, :3], motions[..., :3, 3]
    result = np.zeros((*rotation.shape[:-2], 6, 6))
    result[..., :3, :3] = rotation
    result[..., 3:, 3:] = rotation
    result[..., 3:, :3] = hat(translation) @ rotation
    return result


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotation (3, 3) nearest to a matrix in the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def relative_motions(hands: Array, boards: Array) -> tuple[Array, Array]:
    """Return the pairs (A, B), each (m, 4, 4), with A·X = X·B, of all pairs of stations.

    ``hands`` and ``boards`` (n, 4, 4) satisfy hand·X·board = constant.  Of very many pairs an even share is taken.
    """
    i, j = np.triu_indices(len(hands), 1)
    if len(i) > MAX_PAIRS:
        keep = np.linspace(0, len(i) - 1, MAX_PAIRS).astype(int)
        i, j = i[keep], j[keep]
    return inverse(hands[j]) @ hands[i], boards[j] @ inverse(boards[i])


def kuka_matrix(frames: Array) -> Array:
    """Return the motions (n, 4, 4) of KUKA frames (n, 6): X Y Z in mm, A B C in degrees, R = Rz(A)·Ry(B)·Rx(C)."""
    frames = np.asarray(frames, np.float64).reshape(-1, 6)
    turn = Rotation.from_euler("ZYX", frames[:, 3:], degrees=True).as_matrix()
    return rigid(np.asarray(turn, np.float64), frames[:, :3])
