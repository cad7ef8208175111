"""What is a calibration?  The lens and the place of one camera, and the way between its pixels and the table in mm.

Frames of reference: *image* (u right, v down, the centre of the top-left pixel is 0, 0); *camera* (X right, Y down,
Z along the view); *table* (mm, Z up, z = 0 on the work plane).  A point on the upper face of a slab of thickness t has
z = t.

Source of the models: Z. Zhang, "A flexible new technique for camera calibration", PAMI 22(11), 2000; OpenCV 4,
"Camera calibration and 3D reconstruction"; J. Kannala, S. Brandt, PAMI 28(8), 2006 for the fisheye model.
"""

from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["Calibration", "CameraIdentity", "HandEye", "Lens", "TablePlane"]

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """Which camera, and which part of its sensor, a calibration belongs to.  An empty serial binds to size alone."""

    width: int
    height: int
    serial: str = ""
    offset_x: int = 0
    offset_y: int = 0
    binning: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """Intrinsics: ``matrix`` (3, 3) in pixels and the distortion coefficients in OpenCV's order."""

    matrix: Matrix
    distortion: npt.NDArray[np.float64]
    model: Literal["brown", "fisheye"] = "brown"


@dataclass(frozen=True, slots=True, eq=False)
class TablePlane:
    """The table in the camera's frame: X_camera = rotation·X_plane + translation (mm).

    ``adjustment`` (2, 3) takes x, y of that rigid plane to the table's x, y: table = adjustment·(x, y, 1).  It is the
    identity unless touched points showed that the robot's millimetres are scaled or skewed.
    """

    rotation: Matrix
    translation: npt.NDArray[np.float64]
    adjustment: Matrix = field(default_factory=lambda: np.eye(2, 3))


@dataclass(frozen=True, slots=True, eq=False)
class HandEye:
    """Where the camera sits: in the robot's base (eye-to-hand) or on its flange (eye-in-hand).

    X_parent = rotation·X_camera + translation (mm), the parent being base or flange.
    """

    mount: Literal["eye-to-hand", "eye-in-hand"]
    rotation: Matrix
    translation: npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Lens, table plane and what they were made from.

    ``plane`` is None until `slabcell calibrate plane` has run, ``hand_eye`` until `slabcell calibrate hand-eye` has.
    """

    camera: CameraIdentity
    lens: Lens
    plane: TablePlane | None = None
    diagnostics: dict[str, object] = field(default_factory=dict[str, object])
    hand_eye: HandEye | None = None

    def require_plane(self) -> TablePlane:
        """Return the plane, or raise CalibrationError that says how to get one."""
        if self.plane is None:
            msg = "this calibration knows the lens but not the table: run `slabcell calibrate plane` on it first"
            raise CalibrationError(msg)
        return self.plane

    def require_size(self, width: int, height: int, source: str) -> None:
        """Raise CalibrationError unless a picture of this size is of the calibrated camera."""
        if (width, height) != (self.camera.width, self.camera.height):
            msg = (
                f"{source} has {width}x{height} pixels, the calibration is of {self.camera.width}x{self.camera.height}:"
                " take the picture with the settings of the calibration, or calibrate again"
            )
            raise CalibrationError(msg)

    def require_camera(self, camera: CameraIdentity, source: str) -> None:
        """Raise CalibrationError unless ``camera`` is the calibrated one; an empty serial on either side fits any."""
        self.require_size(camera.width, camera.height, source)
        own = self.camera
        pairs: list[tuple[str, str | int, str | int]] = [
            ("region offset x", camera.offset_x, own.offset_x),
            ("region offset y", camera.offset_y, own.offset_y),
            ("binning", camera.binning, own.binning),
        ]
        if camera.serial and own.serial:
            pairs.insert(0, ("serial number", camera.serial, own.serial))
        differences = [f"{what} {theirs} instead of {ours}" for what, theirs, ours in pairs if theirs != ours]
        if differences:
            msg = (
                f"{source} is not the calibrated camera: {', '.join(differences)}; use its own calibration, set the "
                "camera"
                " as it was, or calibrate again"
            )
            raise CalibrationError(msg)

    def table_from_image(self, pixels: Points, height_mm: float | npt.NDArray[np.float64] = 0.0) -> Points:
        """Return where pixels, shape (n, 2), meet the plane z = ``height_mm`` of the table; shape (n, 2), mm."""
        plane = self.require_plane()
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        if len(points) == 0:
            return np.zeros((0, 2))
        if self.lens.model == "fisheye":
            ideal = cv2.fisheye.undistortPoints(points, self.lens.matrix, self.lens.distortion)
        else:
            stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
            ideal = cv2.undistortPointsIter(
                points, self.lens.matrix, self.lens.distortion, np.eye(3), self.lens.matrix, stop
            )
            ideal = (ideal - self.lens.matrix[:2, 2]) / self.lens.matrix[[0, 1], [0, 1]]
        rays = np.column_stack([ideal.reshape(-1, 2), np.ones(len(points))]) @ plane.rotation
        origin = -plane.rotation.T @ plane.translation
        depth = (np.asarray(height_mm) - origin[2]) / rays[:, 2]
        flat = (origin + rays * depth[:, None])[:, :2]
        return flat @ plane.adjustment[:, :2].T + plane.adjustment[:, 2]

    def image_from_table(self, points: Points, height_mm: float | npt.NDArray[np.float64] = 0.0) -> Points:
        """Return the pixels, shape (n, 2), at which points (n, 2) of the plane z = ``height_mm`` are seen."""
        plane = self.require_plane()
        flat = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        if len(flat) == 0:
            return np.zeros((0, 2))
        flat = np.linalg.solve(plane.adjustment[:, :2], (flat - plane.adjustment[:, 2]).T).T
        solid = np.column_stack([flat, np.broadcast_to(np.asarray(height_mm, float), len(flat))]).reshape(-1, 1, 3)
        turn, _ = cv2.Rodrigues(plane.rotation)
        if self.lens.model == "fisheye":
            pixels, _ = cv2.fisheye.projectPoints(
                solid, turn, plane.translation, self.lens.matrix, self.lens.distortion
            )
        else:
            pixels, _ = cv2.projectPoints(solid, turn, plane.translation, self.lens.matrix, self.lens.distortion)
        return np.asarray(pixels, np.float64).reshape(-1, 2)
