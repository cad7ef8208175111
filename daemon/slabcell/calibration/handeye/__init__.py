"""Where does the camera sit relative to the robot?  Hand-eye calibration: the field's methods and a joint estimate."""

from slabcell.calibration.handeye.calibrate import HandEyeResult, calibrate_hand_eye, kuka_frame
from slabcell.calibration.handeye.solve import HandEyeMethod, Placement, place_camera
from slabcell.calibration.handeye.stations import Mount, RobotPose, Stations, load_poses, make_stations, parse_pose

__all__ = [
    "HandEyeMethod",
    "HandEyeResult",
    "Mount",
    "Placement",
    "RobotPose",
    "Stations",
    "calibrate_hand_eye",
    "kuka_frame",
    "load_poses",
    "make_stations",
    "parse_pose",
    "place_camera",
]
