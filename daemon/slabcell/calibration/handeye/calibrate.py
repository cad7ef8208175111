"""Where does the camera sit relative to the robot?  From stations to a calibration, and how to judge it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from slabcell.calibration.boards import Board
from slabcell.calibration.detection import Detection
from slabcell.calibration.handeye.diagnose import (
    Diversity,
    Residual,
    angle_disagreement_deg,
    axis_disagreement_mm,
    board_residuals,
    board_scale,
    bootstrap_spread,
    holdout,
    measure_diversity,
    other_readings,
    outlying,
)
from slabcell.calibration.handeye.motion import Array, kuka_matrix, rigid
from slabcell.calibration.handeye.solve import HandEyeMethod, Placement, place_camera
from slabcell.calibration.handeye.stations import Mount, RobotPose, Stations, make_stations
from slabcell.calibration.model import Calibration, HandEye
from slabcell.errors import CalibrationError

__all__ = ["HandEyeResult", "calibrate_hand_eye", "kuka_frame"]

MIN_STATIONS = 4  # one can be left out of them, and three are left
MAX_LEFT_OUT = 0.25
SCALE_LIMIT = 0.002
SUSPICIOUS_MM = 2.0
HOPELESS_MM = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class HandEyeResult:
    """A calibration that knows where the camera sits, and what a person needs to judge it.

    ``camera`` and ``board`` are KUKA frames X Y Z A B C: for eye-to-hand the camera in the base and the board on the
    flange, for eye-in-hand the camera on the flange and the board in the base.  ``table`` is the table frame in the
    base, where the calibration knows the table, and where the robot stood when a camera on its flange saw it.
    """

    calibration: Calibration
    mount: Mount
    method: HandEyeMethod
    camera: tuple[float, ...]
    board: tuple[float, ...]
    table: tuple[float, ...] | None
    stations: tuple[Residual, ...]
    left_out: tuple[str, ...]
    holdout_px: float
    holdout_mm: float
    spread_mm: float
    spread_deg: float
    robot_mm: float | None
    robot_deg: float | None
    scale: float
    scale_std: float
    angle_disagreement_deg: float
    axis_disagreement_mm: float
    diversity: Diversity
    warnings: tuple[str, ...]

    def to_document(self) -> dict[str, object]:
        """Return everything but the calibration as JSON values."""
        names = [name for name in self.__slots__ if name not in ("calibration", "stations", "diversity")]
        document: dict[str, object] = {name: getattr(self, name) for name in names}
        document["stations"] = [asdict(r) for r in self.stations]
        document["diversity"] = asdict(self.diversity)
        return document


def calibrate_hand_eye(
    calibration: Calibration,
    detections: Sequence[Detection],
    poses: Sequence[RobotPose],
    board: Board,
    mount: Mount,
    *,
    method: HandEyeMethod = "joint",
    robot_mm: float | None = None,
    robot_deg: float | None = None,
    photo_pose: RobotPose | None = None,
) -> HandEyeResult:
    """Return the calibration with the place of the camera.

    ``photo_pose`` is where the robot stands when it looks at the table; a camera on the flange needs it to give the
    table's frame in the base.  Stations that disagree with all others are named and left out.  Raises CalibrationError
    where the poses leave the camera's place open, or where they fit the other mount or another reading of the angles.
    """
    if board.turns_alike:
        raise CalibrationError(
            f"{board} looks the same after half a turn, so that its frame would jump between the pictures: use a "
            "board with"
            " an odd sum of columns and rows, such as 12x9, or ChArUco"
        )
    stations = make_stations(calibration, detections, poses)
    diversity = _require_diversity(stations)
    _require_fit(stations, mount)
    everything = stations
    placement = place_camera(stations, mount, method, robot_mm=robot_mm, robot_deg=robot_deg)
    held = holdout(stations, mount, method, placement)
    left_out: list[str] = []
    while len(stations) > MIN_STATIONS + 1 and (bad := outlying(held)):
        worst = max(bad, key=lambda n: held[n].mm)
        if len(left_out) + 1 > MAX_LEFT_OUT * len(everything):
            break
        left_out.append(stations.names[worst])
        stations = stations.part([n for n in range(len(stations)) if n != worst])
        placement = place_camera(stations, mount, method, robot_mm=robot_mm, robot_deg=robot_deg)
        held = holdout(stations, mount, method, placement)
    spread_mm, spread_deg = bootstrap_spread(stations, mount, method, placement)
    scale, scale_std = board_scale(stations, mount, placement)
    done = replace(calibration, hand_eye=HandEye(mount, placement.camera[:3, :3], placement.camera[:3, 3]))
    result = HandEyeResult(
        done,
        mount,
        method,
        kuka_frame(placement.camera),
        kuka_frame(placement.board),
        _table(done, placement, photo_pose),
        tuple(board_residuals(everything, mount, placement)),
        tuple(left_out),
        float(np.sqrt(np.mean([r.px**2 for r in held]))),
        float(np.sqrt(np.mean([r.mm**2 for r in held]))),
        spread_mm,
        spread_deg,
        placement.robot_mm,
        placement.robot_deg,
        scale,
        scale_std,
        angle_disagreement_deg(stations),
        axis_disagreement_mm(stations, mount),
        diversity,
        (),
    )
    result = replace(result, warnings=_warnings(result))
    document = {**done.diagnostics, "hand_eye": {"board_target": str(board), **result.to_document()}}
    return replace(result, calibration=replace(done, diagnostics=document))


def kuka_frame(motion: Array) -> tuple[float, ...]:
    """Return X Y Z (mm) and A B C (degrees) of a motion (4, 4)."""
    # SciPy warns at B = ±90°, where A and C are not unique; the tiny turn picks one of the many right answers.
    angles = Rotation.from_matrix(motion[:3, :3]).as_euler("ZYX", degrees=True)
    return (*(float(v) for v in motion[:3, 3]), *(float(v) for v in angles))


def _table(calibration: Calibration, placement: Placement, photo_pose: RobotPose | None) -> tuple[float, ...] | None:
    hand_eye, plane = calibration.hand_eye, calibration.plane
    if hand_eye is None or plane is None:
        return None
    table = placement.camera @ rigid(plane.rotation, plane.translation)
    if hand_eye.mount == "eye-to-hand":
        return kuka_frame(table)
    return None if photo_pose is None else kuka_frame(kuka_matrix(np.array(photo_pose.frame))[0] @ table)


def _require_diversity(stations: Stations) -> Diversity:
    if len(stations) < MIN_STATIONS:
        raise CalibrationError(
            f"{len(stations)} stations do not give a camera's place: at least {MIN_STATIONS} are needed, 15 are good"
        )
    diversity = measure_diversity(stations)
    if diversity.largest_deg < 5.0 or diversity.axis_spread < 0.03:
        raise CalibrationError(
            f"the poses leave the camera's place open (they turn by {diversity.largest_deg:.1f}° at most, about axes "
            "whose"
            f" spread is {diversity.axis_spread:.2f}): tilt the flange by ±30° about two different axes"
        )
    return diversity


def _require_fit(stations: Stations, mount: Mount) -> None:
    """Raise CalibrationError if the poses do not fit the pictures, and say so if another reading of them does."""
    misfit_mm = _misfit_mm(stations, mount)
    if misfit_mm < SUSPICIOUS_MM:
        return
    other: Mount = "eye-in-hand" if mount == "eye-to-hand" else "eye-to-hand"
    there_mm = _misfit_mm(stations, other)
    if there_mm < 0.2 * misfit_mm:
        raise CalibrationError(
            f"the poses fit --mount {other} ({there_mm:.2f} mm) and not {mount} ({misfit_mm:.1f} mm): is the mount"
            " right, and are the poses those of the flange in the base?"
        )
    for reading, robot in other_readings(stations).items():
        there_mm = _misfit_mm(replace(stations, robot=robot), mount)
        if there_mm < 0.2 * misfit_mm:
            raise CalibrationError(
                f"A, B, C must be degrees with R = Rz(A)·Ry(B)·Rx(C); these fit as {reading} (misfit {there_mm:.2f} mm"
                f" instead of {misfit_mm:.1f} mm)"
            )
    if misfit_mm > HOPELESS_MM:
        raise CalibrationError(
            f"the boards are {misfit_mm:.0f} mm from where the robot would hold them, and robot and camera disagree by"
            f" {angle_disagreement_deg(stations):.1f}° about angles: are these the poses of these pictures?"
        )


def _misfit_mm(stations: Stations, mount: Mount) -> float:
    placement = place_camera(stations, mount, "park")
    return float(np.median([r.mm for r in board_residuals(stations, mount, placement)]))


def _warnings(result: HandEyeResult) -> tuple[str, ...]:
    lines = [
        f"{name} was left out: robot and camera disagree there while the others agree; is it the pose of that picture?"
        for name in result.left_out
    ]
    lines += result.diversity.warnings()
    used = len(result.stations) - len(result.left_out)
    if used < 10:
        lines.append(f"only {used} stations: 15 halve the error that 6 leave")
    if abs(result.scale - 1.0) > max(SCALE_LIMIT, 3.0 * result.scale_std):
        lines.append(
            f"the robot moves {100.0 * (result.scale - 1.0):+.2f} % ± {100.0 * result.scale_std:.2f} % against the "
            "board's"
            " millimetres: measure the board's squares, and check the lens"
        )
    if result.angle_disagreement_deg > 0.3:
        lines.append(
            f"robot and camera disagree by {result.angle_disagreement_deg:.2f}° about the angles between stations: "
            "check the"
            " poses, that the robot stood still, and that the board does not slip"
        )
    if result.holdout_mm > 1.0:
        lines.append(
            f"a board is found {result.holdout_mm:.2f} mm from where the robot holds it: for picking from a table, "
            "touch points"
            " of the table instead (slabcell calibrate plane --touch)"
        )
    return tuple(lines)
