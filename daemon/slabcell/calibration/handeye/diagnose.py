"""How far may a hand-eye calibration be trusted?  Residuals, hold-out, spread, and tests for the usual mistakes."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from slabcell.calibration.handeye.motion import Array, inverse, kuka_matrix, relative_motions, rigid, rotation_log
from slabcell.calibration.handeye.solve import HandEyeMethod, Placement, place_camera
from slabcell.calibration.handeye.stations import Mount, Stations
from slabcell.calibration.projection import project, rms_length

__all__ = [
    "Diversity",
    "Residual",
    "angle_disagreement_deg",
    "axis_disagreement_mm",
    "board_residuals",
    "board_scale",
    "bootstrap_spread",
    "holdout",
    "measure_diversity",
    "other_readings",
    "outlying",
]


@dataclass(frozen=True, slots=True)
class Residual:
    """How far one station's board is from where robot and calibration put it: in the picture, and at its middle."""

    name: str
    px: float
    mm: float
    deg: float


def board_residuals(stations: Stations, mount: Mount, placement: Placement) -> list[Residual]:
    """Return the residual of each station."""
    predicted = inverse(placement.camera) @ inverse(stations.hands(mount)) @ placement.board
    found: list[Residual] = []
    for n, view in enumerate(stations.detections):
        turn, _ = cv2.Rodrigues(predicted[n, :3, :3])
        pose = np.concatenate([np.asarray(turn, np.float64).ravel(), predicted[n, :3, 3]])
        pixels, _, _ = project(view.points_mm, pose, stations.calibration.lens)
        middle = np.array([*view.points_mm.mean(axis=0), 1.0])
        away = float(np.linalg.norm(((predicted[n] - stations.boards[n]) @ middle)[:3]))
        lean = rotation_log((predicted[n, :3, :3] @ stations.boards[n, :3, :3].T)[None])[0]
        degrees = float(np.rad2deg(np.linalg.norm(lean)))
        found.append(Residual(view.name, rms_length(pixels - view.pixels), away, degrees))
    return found


def holdout(stations: Stations, mount: Mount, method: HandEyeMethod, whole: Placement) -> list[Residual]:
    """Return the residual of each station in a calibration that was made without it."""
    found: list[Residual] = []
    for n in range(len(stations)):
        rest = stations.part([i for i in range(len(stations)) if i != n])
        placement = place_camera(rest, mount, method, robot_mm=whole.robot_mm, robot_deg=whole.robot_deg)
        found += board_residuals(stations.part([n]), mount, placement)
    return found


def bootstrap_spread(
    stations: Stations, mount: Mount, method: HandEyeMethod, whole: Placement, *, trials: int = 30, seed: int = 0
) -> tuple[float, float]:
    """Return how much the camera's place varies over resampled stations (one standard deviation: mm, degrees)."""
    random = np.random.default_rng(seed)
    middles = (stations.boards @ np.array([0.0, 0.0, 0.0, 1.0]))[:, :3]
    spot = np.array([*np.median(middles, axis=0), 1.0])
    spots: list[Array] = []
    turns: list[Array] = []
    for _ in range(trials):
        index = sorted(int(i) for i in random.integers(0, len(stations), len(stations)))
        if len(set(index)) < 3:
            continue
        camera = place_camera(
            stations.part(index), mount, method, robot_mm=whole.robot_mm, robot_deg=whole.robot_deg
        ).camera
        spots.append((camera @ spot)[:3])
        turns.append(rotation_log((camera[:3, :3] @ whole.camera[:3, :3].T)[None])[0])
    if len(spots) < 2:
        return float("inf"), float("inf")
    mm = float(np.linalg.norm(np.std(np.array(spots), axis=0, ddof=1)))
    return mm, float(np.rad2deg(np.linalg.norm(np.std(np.array(turns), axis=0, ddof=1))))


@dataclass(frozen=True, slots=True)
class Diversity:
    """How much the stations differ.

    ``largest_deg``: greatest rotation between two stations.  ``axis_spread``: 0 if all rotations share one axis, 1 if
    no direction is preferred (second singular value of the rotation vectors over the first).
    """

    largest_deg: float
    axis_spread: float

    def warnings(self) -> list[str]:
        """Return what a person should do about it, in words."""
        lines: list[str] = []
        if self.largest_deg < 30.0:
            lines.append(
                f"the poses differ by {self.largest_deg:.0f}° at most: turn the flange by ±30° or more in different "
                "directions"
            )
        if self.axis_spread < 0.25:
            lines.append(
                "the flange turns about nearly one axis only: tilt it about a second one, or height stays open"
            )
        return lines


def measure_diversity(stations: Stations) -> Diversity:
    """Return how much the robot's poses differ."""
    pairs, _ = relative_motions(stations.robot, stations.boards)
    turns = rotation_log(pairs[:, :3, :3])
    values = np.linalg.svd(turns, compute_uv=False)
    largest = float(np.rad2deg(np.linalg.norm(turns, axis=1).max()))
    return Diversity(largest, float(values[1] / max(values[0], 1e-12)) if len(values) > 1 else 0.0)


def angle_disagreement_deg(stations: Stations) -> float:
    """Return by how much robot and camera disagree about the angle between two stations (rms, degrees).

    The angle does not depend on where camera and board sit, so this tells wrong poses from a wrong calibration.
    """
    pairs, seen = relative_motions(stations.robot, stations.boards)
    difference = np.linalg.norm(rotation_log(pairs[:, :3, :3]), axis=1) - np.linalg.norm(
        rotation_log(seen[:, :3, :3]), axis=1
    )
    return float(np.rad2deg(np.sqrt((difference * difference).mean())))


def axis_disagreement_mm(stations: Stations, mount: Mount) -> float:
    """Return by how much robot and camera disagree about the shift along a common rotation axis (rms, mm).

    Of a pair of stations it is as independent of the calibration as the angle; pairs that turn by less than 5° have no
    axis to speak of and are left out.
    """
    pairs, seen = relative_motions(stations.hands(mount), stations.boards)
    turn_a, turn_b = rotation_log(pairs[:, :3, :3]), rotation_log(seen[:, :3, :3])
    angle_a, angle_b = np.linalg.norm(turn_a, axis=1), np.linalg.norm(turn_b, axis=1)
    use = (np.minimum(angle_a, angle_b) > np.deg2rad(5.0)) & (np.maximum(angle_a, angle_b) < np.deg2rad(175.0))
    if not use.any():
        return 0.0
    along_a = np.einsum("ni,ni->n", turn_a[use] / angle_a[use, None], pairs[use, :3, 3])
    along_b = np.einsum("ni,ni->n", turn_b[use] / angle_b[use, None], seen[use, :3, 3])
    return float(np.sqrt(np.square(along_a - along_b).mean()))


def other_readings(stations: Stations) -> dict[str, Array]:
    """Return what the poses (n, 4, 4) would be if their angles were meant otherwise, by what a person is to do."""
    frames = stations.frames
    shifts, angles = frames[:, :3], frames[:, 3:]
    in_degrees, in_radians = (
        rigid(np.asarray(Rotation.from_rotvec(turn).as_matrix(), np.float64), shifts)
        for turn in (np.deg2rad(angles), angles)
    )
    return {
        "angles about X, Y, Z: write the angle about Z first": kuka_matrix(frames[:, [0, 1, 2, 5, 4, 3]]),
        "angles in radians: write degrees": kuka_matrix(np.hstack([shifts, np.rad2deg(angles)])),
        "a rotation vector in radians: convert it": in_radians,
        "a rotation vector in degrees: convert it": in_degrees,
    }


def board_scale(stations: Stations, mount: Mount, placement: Placement) -> tuple[float, float]:
    """Return how large the robot's millimetres are in the board's, relative to 1, and the standard deviation.

    All moves between stations are fitted with one scale more; the standard deviation is that of their own residuals.
    """
    pairs, seen = relative_motions(stations.hands(mount), stations.boards)
    rotation = placement.camera[:3, :3]
    rows = np.concatenate([np.eye(3) - pairs[:, :3, :3], (seen[:, :3, 3] @ rotation.T)[:, :, None]], axis=2).reshape(
        -1, 4
    )
    right = pairs[:, :3, 3].ravel()
    solution = np.asarray(np.linalg.lstsq(rows, right, rcond=None)[0], np.float64)
    residual = right - rows @ solution
    # n stations give n(n-1)/2 pairs, but only n-1 independent ones.
    freedom = max(3 * (len(stations) - 1) - 4, 1)
    share = 3 * (len(stations) - 1) / len(right)
    variance = float(residual @ residual) * share / freedom
    information = rows.T @ rows * share
    return float(solution[3]), float(np.sqrt(variance * np.linalg.pinv(information, hermitian=True)[3, 3]))


def outlying(residuals: Sequence[Residual], factor: float = 5.0, floor_mm: float = 0.2) -> list[int]:
    """Return the stations whose hold-out residual is far above the others'."""
    mm = np.array([r.mm for r in residuals])
    limit = max(factor * float(np.median(mm)), floor_mm)
    return [int(i) for i in np.flatnonzero(mm > limit)]
