"""How far off is the work plane after a hand-eye calibration, method by method?  And after touching points of it?

Run ``python benchmarks/calibration_handeye.py [--trials 40]``.  A camera hangs 1040 mm above the table; an arm shows it
a 12x9 board of 16 mm squares, tilted up to ±30° about every axis, 15 times.  Corners have noise of 0.05 px, robot poses
0.15 mm in each direction and 0.02° about each axis.  Error: how far points of the table (560 x 340 mm) are from where
they are taken to be in the robot's base, in the plane; median and 95th percentile over points and trials.  The lens is
known.

The second table touches points of the table instead, with noise of 0.1 mm in x and y, in an n x n grid from corner to
corner of the same 560 x 340 mm, and compares over them.
"""

import argparse
import time

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from slabcell.calibration import Board, Calibration, CameraIdentity, Detection, Lens, RobotPose, Touch
from slabcell.calibration.handeye import kuka_frame, make_stations, place_camera
from slabcell.calibration.handeye.motion import inverse, kuka_matrix, rigid
from slabcell.calibration.touch import fit_touch

Array = npt.NDArray[np.float64]

BOARD = Board.parse("checkerboard:12x9:16")
LENS = Lens(np.array([[3333.0, 0, 959.5], [0, 3333.0, 599.5], [0, 0, 1]]), np.array([-0.11, 0.16, 4e-4, -3e-4, 0.0]))
SIZE = (1920, 1200)
CAMERA = kuka_matrix(np.array([290.0, -45.0, 1040.0, -90.4, 0.5, 179.4]))[0]
ON_FLANGE = kuka_matrix(np.array([-80.0, 60.0, 40.0, 3.0, 2.0, 178.0]))[0]
METHODS = ("tsai", "park", "horaud", "andreff", "daniilidis", "shah", "li", "joint")
PEERS = {
    "OpenCV tsai": cv2.CALIB_HAND_EYE_TSAI,
    "OpenCV park": cv2.CALIB_HAND_EYE_PARK,
    "OpenCV horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "OpenCV andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "OpenCV daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
CONDITIONS = {
    "15 poses ±30°, 0.15 mm/0.02°": {},
    "rotation noise 0.10°": {"robot_deg": 0.10},
    "translation noise 0.6 mm": {"robot_mm": 0.6},
    "±10° only": {"tilt_deg": 10.0},
    "6 poses": {"count": 6},
    "40 poses": {"count": 40},
    "perfect robot": {"robot_mm": 0.0, "robot_deg": 0.0},
}
PLANE = np.stack(np.meshgrid(np.linspace(-280, 280, 8), np.linspace(-170, 170, 6)), axis=-1).reshape(-1, 2)


def shoot(
    seed: int, *, count: int = 15, tilt_deg: float = 30.0, robot_mm: float = 0.15, robot_deg: float = 0.02
) -> tuple[list[Detection], list[RobotPose]]:
    """Return what camera and robot report."""
    random = np.random.default_rng(seed)
    detections: list[Detection] = []
    poses: list[RobotPose] = []
    while len(detections) < count:
        tilt = Rotation.from_rotvec(np.deg2rad(random.uniform(-tilt_deg, tilt_deg, 3))).as_matrix()
        turn = np.diag([1.0, -1.0, -1.0]) @ tilt
        centre = np.array([random.uniform(-170, 170), random.uniform(-90, 90), random.uniform(700, 950)])
        board = rigid(turn, centre - turn @ (88.0, 64.0, 0.0))
        pixels, _ = cv2.projectPoints(BOARD.points, cv2.Rodrigues(turn)[0], board[:3, 3], LENS.matrix, LENS.distortion)
        pixels = pixels.reshape(-1, 2)
        if pixels.min() < 5 or (pixels > np.array(SIZE) - 6).any():
            continue
        flange = CAMERA @ board @ inverse(ON_FLANGE)
        slip = Rotation.from_rotvec(np.deg2rad(random.normal(0.0, robot_deg, 3))).as_matrix()
        flange[:3, :3] = slip @ flange[:3, :3]
        flange[:3, 3] += random.normal(0.0, robot_mm, 3)
        name = str(len(detections))
        noisy = pixels + random.normal(0.0, 0.05, pixels.shape)
        detections.append(Detection(name, *SIZE, np.arange(len(BOARD.points)), BOARD.points, noisy))
        poses.append(RobotPose(name, kuka_frame(flange)))
    return detections, poses


def plane_errors_mm(found: Array) -> Array:
    """Return the errors of points all over the table."""
    seen = np.column_stack([PLANE, np.full(len(PLANE), 1040.0), np.ones(len(PLANE))])
    return np.linalg.norm((seen @ (found - CAMERA).T)[:, :2], axis=1)


def hand_eye(trials: int) -> None:
    """Print the table of the methods."""
    known = Calibration(CameraIdentity(*SIZE), LENS)
    names = [*METHODS, *PEERS]
    print(f"{'work plane error, median/95 % mm':34}" + "".join(f"{n.replace('OpenCV', 'cv'):>15}" for n in names))
    for condition, values in CONDITIONS.items():
        errors: dict[str, list[Array]] = {name: [] for name in names}
        seconds = 0.0
        for seed in range(trials):
            stations = make_stations(known, *shoot(seed, **values))
            for method in METHODS:
                began = time.perf_counter()
                errors[method].append(plane_errors_mm(place_camera(stations, "eye-to-hand", method).camera))
                seconds += (time.perf_counter() - began) * (method == "joint")
            hands = stations.hands("eye-to-hand")
            for name, number in PEERS.items():
                turn, shift = cv2.calibrateHandEye(
                    list(hands[:, :3, :3]), list(hands[:, :3, 3]), list(stations.boards[:, :3, :3]),
                    list(stations.boards[:, :3, 3]), method=number,
                )  # fmt: skip
                errors[name].append(plane_errors_mm(rigid(turn, shift.ravel())))
        cells = [f"{np.median(e):.3f}/{np.percentile(e, 95):.3f}" for e in errors.values()]
        print(
            f"{condition:34}" + "".join(f"{cell:>15}" for cell in cells) + f"   joint {1e3 * seconds / trials:.0f} ms"
        )


def touch_off(trials: int) -> None:
    """Print the table of touched grids."""
    print("\n" + "touched points, 0.1 mm noise".ljust(34) + "".join(f"{n:>15}" for n in ("rigid", "affine", "chosen")))
    for size, robot in ((3, "true"), (4, "true"), (3, "scale +0.1 %, skew 0.02°"), (4, "scale +0.1 %, skew 0.02°")):
        across, along = np.linspace(-280, 280, size), np.linspace(-170, 170, size)
        spots = np.stack(np.meshgrid(across, along), axis=-1).reshape(-1, 2)
        stretch = np.eye(2) if robot == "true" else 1.001 * np.array([[1.0, np.deg2rad(0.02)], [0.0, 1.0]])
        errors: dict[str, list[Array]] = {"rigid": [], "affine": [], "chosen": []}
        for seed in range(trials):
            random = np.random.default_rng(seed)
            angle, shift = random.uniform(-np.pi, np.pi), random.uniform(-200.0, 200.0, 2)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            motion = stretch @ turn
            robot_xy = spots @ motion.T + shift + random.normal(0.0, 0.1, spots.shape)
            touches = [Touch(str(n), x, y) for n, (x, y) in enumerate(robot_xy)]
            for name, affine in (("rigid", False), ("affine", True), ("chosen", None)):
                matrix = fit_touch(spots, touches, affine=affine).matrix
                apart = PLANE @ (matrix[:, :2] - motion).T + matrix[:, 2] - shift
                errors[name].append(np.linalg.norm(apart, axis=1))
        cells = [f"{np.median(e):.3f}/{np.percentile(e, 95):.3f}" for e in errors.values()]
        print(f"{f'{size}x{size}, robot {robot}':34}" + "".join(f"{cell:>15}" for cell in cells))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=40)
    trials = parser.parse_args().trials
    hand_eye(trials)
    touch_off(5 * trials)


if __name__ == "__main__":
    main()
