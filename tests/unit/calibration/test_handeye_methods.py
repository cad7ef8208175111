"""Every hand-eye method finds the truth where there is no noise, and agrees with OpenCV where there is."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slabcell.calibration.handeye.motion import (
    adjoint,
    inverse,
    kuka_matrix,
    motion_exp,
    motion_log,
    relative_motions,
    rigid,
)
from slabcell.calibration.handeye.robot_world import li, shah
from slabcell.calibration.handeye.separate import horaud, park, tsai
from slabcell.calibration.handeye.simultaneous import andreff, daniilidis
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

FROM_PAIRS = {
    tsai: cv2.CALIB_HAND_EYE_TSAI,
    park: cv2.CALIB_HAND_EYE_PARK,
    horaud: cv2.CALIB_HAND_EYE_HORAUD,
    andreff: cv2.CALIB_HAND_EYE_ANDREFF,
    daniilidis: cv2.CALIB_HAND_EYE_DANIILIDIS,
}
FROM_STATIONS = {shah: cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH, li: cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI}
CAMERAS = {
    "tilted": rigid(Rotation.from_rotvec([0.3, -2.0, 0.5]).as_matrix(), np.array([50.0, -30.0, 80.0])),
    "looking down": rigid(np.diag([1.0, -1.0, -1.0]), np.array([290.0, -45.0, 1040.0])),
}
BOARD = rigid(Rotation.from_rotvec([0.1, 0.2, 1.0]).as_matrix(), np.array([500.0, 100.0, 20.0]))


def stations(camera, noise=0.0, count=15, seed=0):
    """Hands (n, 4, 4) and boards (n, 4, 4) with hand·camera·board = BOARD."""
    random = np.random.default_rng(seed)
    hands = kuka_matrix(np.column_stack([random.uniform(-200, 200, (count, 3)), random.uniform(-40, 40, (count, 3))]))
    errors = np.column_stack([random.normal(0, 3e-4, (count, 3)), random.normal(0, 0.1, (count, 3))]) * noise
    boards = inverse(camera) @ inverse(hands) @ BOARD
    return hands, np.array([motion_exp(e) @ b for e, b in zip(errors, boards, strict=True)])


def distance(found, truth):
    """Return rad and mm between two motions."""
    twist = motion_log((inverse(truth) @ found)[None])[0]
    return np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
@pytest.mark.parametrize("method", [*FROM_PAIRS, *FROM_STATIONS], ids=lambda m: m.__name__)
def test_exact_stations_give_the_exact_camera(method, camera):
    hands, boards = stations(camera)
    if method in FROM_PAIRS:
        found = method(*relative_motions(hands, boards))
    else:
        found, place = method(hands, inverse(boards))
        assert max(distance(place, BOARD)) < 1e-8
    assert max(distance(found, camera)) < 1e-8


@pytest.mark.parametrize("method", FROM_PAIRS, ids=lambda m: m.__name__)
def test_methods_from_pairs_are_as_good_as_opencvs(method):
    camera = CAMERAS["tilted"]
    ours, theirs = [], []
    for seed in range(12):
        hands, boards = stations(camera, noise=1.0, seed=seed)
        turn, shift = cv2.calibrateHandEye(
            list(hands[:, :3, :3]), list(hands[:, :3, 3]), list(boards[:, :3, :3]), list(boards[:, :3, 3]),
            method=FROM_PAIRS[method],
        )  # fmt: skip
        ours.append(distance(method(*relative_motions(hands, boards)), camera))
        theirs.append(distance(rigid(turn, shift.ravel()), camera))
    assert (np.median(ours, axis=0) < 1.25 * np.median(theirs, axis=0)).all()


@pytest.mark.parametrize("method", FROM_STATIONS, ids=lambda m: m.__name__)
def test_methods_from_stations_are_as_good_as_opencvs(method):
    camera = CAMERAS["tilted"]
    ours, theirs = [], []
    for seed in range(12):
        hands, boards = stations(camera, noise=1.0, seed=seed)
        back = inverse(hands)
        *_, turn, shift = cv2.calibrateRobotWorldHandEye(
            list(boards[:, :3, :3]), list(boards[:, :3, 3]), list(back[:, :3, :3]), list(back[:, :3, 3]),
            method=FROM_STATIONS[method],
        )  # fmt: skip
        ours.append(distance(method(hands, inverse(boards))[0], camera))
        theirs.append(distance(inverse(rigid(turn, shift.ravel())), camera))
    assert (np.median(ours, axis=0) < 1.25 * np.median(theirs, axis=0)).all()


def test_park_is_the_same_as_opencvs_to_rounding():
    hands, boards = stations(CAMERAS["tilted"], noise=1.0)
    turn, shift = cv2.calibrateHandEye(
        list(hands[:, :3, :3]), list(hands[:, :3, 3]), list(boards[:, :3, :3]), list(boards[:, :3, 3]),
        method=cv2.CALIB_HAND_EYE_PARK,
    )  # fmt: skip
    assert max(distance(park(*relative_motions(hands, boards)), rigid(turn, shift.ravel()))) < 1e-8


def test_poses_are_read_as_the_robots_frames_are():
    random = np.random.default_rng(1)
    frames = np.column_stack([random.uniform(-900, 900, (20, 3)), random.uniform(-180, 180, (20, 3))])
    for frame, matrix in zip(frames, kuka_matrix(frames), strict=True):
        assert np.abs(Frame(*frame).matrix - matrix).max() < 1e-9


def test_logarithm_and_exponential_undo_each_other():
    random = np.random.default_rng(2)
    for scale in (1e-9, 1e-5, 1e-3, 1.0, 2.5):
        turn = random.normal(size=3)
        twist = np.concatenate([turn / np.linalg.norm(turn) * scale, random.uniform(-100, 100, 3)])
        assert np.abs(motion_log(motion_exp(twist)[None])[0] - twist).max() < 1e-6


def test_the_adjoint_carries_a_twist_through_a_motion():
    motion = CAMERAS["tilted"]
    twist = np.array([0.01, -0.02, 0.03, 1.0, 2.0, -3.0])
    assert np.allclose(motion @ motion_exp(twist), motion_exp(adjoint(motion) @ twist) @ motion)
