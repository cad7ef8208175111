"""How do pixels become millimetres?  Images of boards and robot poses in, a `Calibration` out; pure, no devices."""

from slabcell.calibration.boards import Board
from slabcell.calibration.camera import CameraResult, LensModel, calibrate_camera
from slabcell.calibration.check import BoardCheck, Drift, check_board, drift_of_board, drift_of_marks, load_marks
from slabcell.calibration.detection import Detection, detect_board, detect_boards
from slabcell.calibration.file import from_document as calibration_from_document
from slabcell.calibration.file import load_calibration, save_calibration
from slabcell.calibration.file import to_document as calibration_to_document
from slabcell.calibration.handeye import (
    HandEyeMethod,
    HandEyeResult,
    Mount,
    RobotPose,
    calibrate_hand_eye,
    load_poses,
    parse_pose,
)
from slabcell.calibration.model import Calibration, CameraIdentity, HandEye, Lens, TablePlane
from slabcell.calibration.plane import PlaneResult, calibrate_plane
from slabcell.calibration.touch import Touch, TouchFit, load_touch

__all__ = [
    "Board",
    "BoardCheck",
    "Calibration",
    "CameraIdentity",
    "CameraResult",
    "Detection",
    "Drift",
    "HandEye",
    "HandEyeMethod",
    "HandEyeResult",
    "Lens",
    "LensModel",
    "Mount",
    "PlaneResult",
    "RobotPose",
    "TablePlane",
    "Touch",
    "TouchFit",
    "calibrate_camera",
    "calibrate_hand_eye",
    "calibrate_plane",
    "calibration_from_document",
    "calibration_to_document",
    "check_board",
    "detect_board",
    "detect_boards",
    "drift_of_board",
    "drift_of_marks",
    "load_calibration",
    "load_marks",
    "load_poses",
    "load_touch",
    "parse_pose",
    "save_calibration",
]
