"""Where do camera and board most probably sit, if neither pixels nor robot are exact?  The joint (MAP) estimate.

Every robot pose has a small error of its own: a shift (mm) and a turn (degrees), of unknown size that is estimated
along (restricted maximum likelihood), and every board pose has the uncertainty that its pixels leave it.  The errors
of the poses are integrated out, so that two motions, twelve numbers, remain: the camera's X and the board's Z.  Where
the robot is exact this is bundle adjustment; where it is not, its translation noise does not spoil the result as plain
minimisation of the reprojection error does.

Sources: K. Strobl, G. Hirzinger, "Optimal hand-eye calibration", IROS 2006 (weighting by what robot and camera each get
wrong); H. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58(3),
1971 (restricted maximum likelihood).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from slabcell.calibration.handeye.motion import Array, adjoint, hat, inverse, motion_exp, motion_log
from slabcell.calibration.handeye.stations import Mount, Stations

__all__ = ["JointEstimate", "estimate_jointly"]

MAX_ROUNDS = 20
# What is believed of an industrial robot before it is measured, and how loosely (standard deviation of the logarithm).
USUAL_MM, USUAL_DEG, LOOSENESS = 0.1, 0.02, 1.5
LEAST_MM, LEAST_DEG = 1e-4, 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class JointEstimate:
    """X (camera) and Z (board), each (4, 4), their covariance (12, 12) as local twists, and the robot's noise."""

    camera: Array
    board: Array
    covariance: Array
    robot_mm: float
    robot_deg: float


def estimate_jointly(
    stations: Stations,
    mount: Mount,
    camera: Array,
    board: Array,
    *,
    robot_mm: float | None = None,
    robot_deg: float | None = None,
) -> JointEstimate:
    """Return the most probable places of camera and board, starting from ``camera`` and ``board`` (4, 4).

    ``robot_mm`` and ``robot_deg`` are the standard deviations of a robot pose in each direction and about each axis;
    each is estimated if it is not given.
    """
    vision = np.asarray(np.linalg.inv(stations.information), np.float64)
    start_mm = USUAL_MM if robot_mm is None else max(robot_mm, LEAST_MM)
    start_deg = USUAL_DEG if robot_deg is None else max(robot_deg, LEAST_DEG)
    noise = np.log(np.array([start_mm, np.deg2rad(start_deg)]))
    free = [n for n, given in enumerate((robot_mm, robot_deg)) if given is None]
    covariance = np.eye(12)
    settled = False
    for rounds in range(MAX_ROUNDS):
        error, by_motion, by_robot = _linearised(stations, mount, camera, board)
        if free and not settled:
            before = noise
            noise = _estimate_noise(noise, free, error, by_motion, by_robot, vision)
            settled = rounds > 0 and float(np.abs(noise - before).max()) < 0.01
        weight = np.asarray(np.linalg.inv(_spread(noise, by_robot, vision)), np.float64)
        normal, gradient = _normal_equations(error, by_motion, weight)
        covariance = _inverse(normal)
        step = -covariance @ gradient
        camera, board = camera @ motion_exp(step[:6]), board @ motion_exp(step[6:])
        if float(np.abs(step).max()) < 1e-9:
            break
    return JointEstimate(camera, board, covariance, float(np.exp(noise[0])), float(np.rad2deg(np.exp(noise[1]))))


def _linearised(stations: Stations, mount: Mount, camera: Array, board: Array) -> tuple[Array, Array, Array]:
    """Return how far each board is from where X, Z and the robot put it (twist in the camera's frame, (n, 6)).

    And its derivatives to X and Z (n, 6, 12) and to the robot pose's turn and shift (n, 6, 6).
    """
    hands = stations.hands(mount)
    back = inverse(camera)
    predicted = back @ inverse(hands) @ board
    error = motion_log(predicted @ inverse(stations.boards))
    by_motion = np.concatenate([np.broadcast_to(-np.eye(6), (len(stations), 6, 6)), adjoint(predicted)], axis=2)
    # A turn of the robot is about its flange, and its shift along the axes of the base.
    at_flange = np.broadcast_to(np.eye(6), (len(stations), 6, 6)).copy()
    at_flange[:, 3:, :3] = hat(stations.robot[:, :3, 3])
    if mount == "eye-to-hand":
        return error, by_motion, adjoint(back) @ at_flange
    return error, by_motion, -adjoint(back @ inverse(hands)) @ at_flange


def _normal_equations(error: Array, by_motion: Array, weight: Array) -> tuple[Array, Array]:
    weighted = np.swapaxes(by_motion, 1, 2) @ weight
    return np.asarray((weighted @ by_motion).sum(axis=0)), np.asarray((weighted @ error[:, :, None]).sum(axis=0)[:, 0])


def _inverse(normal: Array) -> Array:
    return np.asarray(np.linalg.pinv(normal, hermitian=True), np.float64)


def _spread(noise: Array, by_robot: Array, vision: Array) -> Array:
    variances = np.exp(2.0 * np.repeat(noise[::-1], 3))
    return vision + (by_robot * variances) @ np.swapaxes(by_robot, 1, 2)


def _estimate_noise(
    noise: Array, free: list[int], error: Array, by_motion: Array, by_robot: Array, vision: Array
) -> Array:
    """Return the logarithms of the robot's noise (mm, rad) that make the errors most probable."""
    usual = np.log(np.array([USUAL_MM, np.deg2rad(USUAL_DEG)]))
    bounds = [(np.log(1e-4), np.log(30.0)), (np.log(1e-7), np.log(0.2))]

    def improbability(values: Array) -> float:
        trial = noise.copy()
        trial[free] = values
        spread = _spread(trial, by_robot, vision)
        weight = np.asarray(np.linalg.inv(spread), np.float64)
        normal, gradient = _normal_equations(error, by_motion, weight)
        left = float(np.einsum("ni,nij,nj->", error, weight, error)) - float(gradient @ _inverse(normal) @ gradient)
        size = float(np.linalg.slogdet(spread)[1].sum()) + float(np.linalg.slogdet(normal)[1])
        belief = float(np.sum(np.square((trial - usual) / LOOSENESS)))
        return left + size + belief

    found = minimize(
        improbability,
        noise[free],
        method="L-BFGS-B",
        bounds=[bounds[n] for n in free],
    )
    result = noise.copy()
    result[free] = found.x
    return result
