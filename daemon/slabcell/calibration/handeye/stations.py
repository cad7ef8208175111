"""What does a hand-eye calibration start from?  Stations: a robot pose, and the board as the camera saw it there.

POSES.csv has a header ``image,X,Y,Z,A,B,C`` and a line for each picture: the pose of the flange (or tool) in the
robot's base, X Y Z in mm, A B C in degrees, R = Rz(A)·Ry(B)·Rx(C) as KUKA shows it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from slabcell.calibration.csv_file import Row, read_rows, rows_of
from slabcell.calibration.detection import Detection, best_variant
from slabcell.calibration.handeye.motion import Array, hat, inverse, kuka_matrix, rigid
from slabcell.calibration.model import Calibration, Lens
from slabcell.calibration.projection import board_pose, project, rms_length
from slabcell.errors import CalibrationError, UsageError

__all__ = ["Mount", "RobotPose", "Stations", "load_poses", "make_stations", "parse_pose", "parse_poses"]

Mount = Literal["eye-to-hand", "eye-in-hand"]

POSES_HEADER = "image,X,Y,Z,A,B,C"
MAX_MM = 1e5
MAX_DEG = 720.0
NOISE_FLOOR_PX = 0.02


@dataclass(frozen=True, slots=True)
class RobotPose:
    """Where the robot was for one picture: X Y Z in mm, A B C in degrees."""

    image: str
    frame: tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Stations:
    """n stations.

    ``frames`` (n, 6): the robot poses as given; ``robot`` (n, 4, 4): flange in the base.  ``boards`` (n, 4, 4): board
    in the camera.  ``information`` (n, 6, 6): what the pixels know about each board's pose, for a twist applied in the
    camera's frame (rad, mm).
    """

    names: tuple[str, ...]
    frames: Array
    robot: Array
    boards: Array
    information: Array
    view_rms_px: Array
    detections: tuple[Detection, ...]
    calibration: Calibration

    def __len__(self) -> int:
        return len(self.names)

    def hands(self, mount: Mount) -> Array:
        """Return the motions H (n, 4, 4) with H·X·board = constant, X the camera's place for this mount."""
        return self.robot if mount == "eye-in-hand" else inverse(self.robot)

    def part(self, keep: Sequence[int]) -> "Stations":
        """Return some of the stations."""
        index = np.asarray(keep, dtype=np.int64)
        return Stations(
            tuple(self.names[i] for i in keep),
            self.frames[index],
            self.robot[index],
            self.boards[index],
            self.information[index],
            self.view_rms_px[index],
            tuple(self.detections[i] for i in keep),
            self.calibration,
        )


def make_stations(calibration: Calibration, detections: Sequence[Detection], poses: Sequence[RobotPose]) -> Stations:
    """Return the stations of the pictures whose robot pose is known.  Raises CalibrationError for one without."""
    by_name = _by_name(poses)
    lens = calibration.lens
    if any(d.variants for d in detections):
        detections = best_variant(detections, lambda trial: sum(_misfit_px(d, lens) ** 2 for d in trial))
    detections = [d.centred(lens) for d in detections]
    robot: list[tuple[float, ...]] = []
    boards: list[Array] = []
    information: list[Array] = []
    rms: list[float] = []
    for view in detections:
        calibration.require_size(view.width, view.height, view.name)
        pose = by_name.get(view.name) or by_name.get(Path(view.name).name)
        if pose is None:
            raise CalibrationError(
                f"{view.name}: no robot pose is given for this picture: add its line to the poses file"
            )
        seen = board_pose(view.points_mm, view.pixels, lens)
        pixels, by_pose, _ = project(view.points_mm, seen, lens)
        turn, _ = cv2.Rodrigues(seen[:3])
        turn = np.asarray(turn, np.float64)
        points = view.points_mm @ turn.T + seen[3:]
        by_point = by_pose[:, 3:].reshape(-1, 2, 3)
        by_twist = np.concatenate([by_point @ -hat(points), by_point], axis=2).reshape(-1, 6)
        residual = rms_length(view.pixels - pixels)
        noise_px = max(residual / np.sqrt(2.0), NOISE_FLOOR_PX)
        robot.append(pose.frame)
        boards.append(rigid(turn, seen[3:]))
        information.append(by_twist.T @ by_twist / noise_px**2)
        rms.append(residual)
    if not boards:
        raise CalibrationError("no picture shows the board: a hand-eye calibration needs at least 4, better 15")
    return Stations(
        tuple(v.name for v in detections),
        np.array(robot, dtype=np.float64),
        kuka_matrix(np.array(robot)),
        np.array(boards),
        np.array(information),
        np.array(rms),
        tuple(detections),
        calibration,
    )


def _misfit_px(view: Detection, lens: Lens) -> float:
    return rms_length(view.pixels - project(view.points_mm, board_pose(view.points_mm, view.pixels, lens), lens)[0])


def _by_name(poses: Sequence[RobotPose]) -> dict[str, RobotPose]:
    found: dict[str, RobotPose] = {}
    for pose in poses:
        if pose.image in found:
            raise CalibrationError(f"the poses file names {pose.image} twice: each picture has one robot pose")
        found[pose.image] = pose
    return found


def parse_pose(text: str, name: str) -> RobotPose:
    """Return the pose written as X,Y,Z,A,B,C (mm, degrees).  Raises UsageError."""
    try:
        values = [float(part) for part in text.split(",")]
        x, y, z, a, b, c = values
    except ValueError as error:
        raise UsageError(f"{name} {text[:80]!r} is not X,Y,Z,A,B,C (mm and degrees)") from error
    if not (all(abs(v) <= MAX_MM for v in (x, y, z)) and all(abs(v) <= MAX_DEG for v in (a, b, c))):
        raise UsageError(f"{name} {text[:80]!r} has a value outside ±{MAX_MM:g} mm or ±{MAX_DEG:g}°")
    return RobotPose(name, (x, y, z, a, b, c))


def load_poses(path: Path) -> list[RobotPose]:
    """Return the robot poses of a CSV file.  Raises CalibrationError that names file, line and column."""
    return _poses(read_rows(path, POSES_HEADER)[1])


def parse_poses(raw: bytes, name: str) -> list[RobotPose]:
    """Return the robot poses of a CSV table that is called ``name``.  Raises CalibrationError."""
    return _poses(rows_of(raw, name, POSES_HEADER)[1])


def _poses(rows: Sequence[Row]) -> list[RobotPose]:
    poses: list[RobotPose] = []
    for row in rows:
        x, y, z = (row.number(column, MAX_MM) for column in "XYZ")
        a, b, c = (row.number(column, MAX_DEG) for column in "ABC")
        poses.append(RobotPose(row.text("image"), (x, y, z, a, b, c)))
    return poses
