"""How does the table's frame follow from points that the robot touched?  A rigid or affine fit, with its own hold-out.

POINTS.csv has a header and one touched point a line, x and y in mm as the robot shows them in the frame that the table
is to have.  What was touched is either a point of the board (``column``, ``row`` from 0, in the picture ``image``; the
first picture if there is no such column) or a mark on the table whose pixel is given (``u``, ``v``)::

    image,column,row,x,y            u,v,x,y
    plane-0.png,0,0,152.31,-104.20  412.5,388.0,152.31,-104.20
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slabcell.calibration.csv_file import read_rows
from slabcell.calibration.model import TablePlane
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["Touch", "TouchFit", "fit_touch", "load_touch"]

MAX_MM = 1e5
MAX_PX = 1e5
MAX_COUNT = 10_000
AFFINE_MIN_POINTS = 6
AFFINE_GAIN = 0.9
"""The affine fit is chosen only if its hold-out residual is below this part of the rigid one's."""


@dataclass(frozen=True, slots=True)
class Touch:
    """One touched point: x and y of the robot, and the board's point or the pixel that was touched."""

    source: str
    x_mm: float
    y_mm: float
    image: str = ""
    corner: tuple[int, int] = (0, 0)
    pixel: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TouchFit:
    """The motion from the board's plane to the robot's x and y, and how well it holds.

    ``matrix`` (2, 3).  ``residual_mm`` is the rms over all points, ``holdout_mm`` over points left out one at a time.
    """

    kind: str
    matrix: Points
    residuals: tuple[tuple[str, float], ...]
    residual_mm: float
    holdout_mm: float
    scale_ppm: float
    warnings: tuple[str, ...]

    def carry(self, plane: TablePlane) -> TablePlane:
        """Return the plane with its x and y turned into the robot's."""
        linear, shift = self.matrix[:, :2], self.matrix[:, 2]
        u, _, vt = np.linalg.svd(linear)
        nearest = u @ vt
        solid = np.eye(3)
        solid[:2, :2] = nearest
        rotation = plane.rotation @ solid.T
        translation = plane.translation - rotation @ np.array([*shift, 0.0])
        # What is left over the rigid part, seen in the robot's own axes.
        stretch = linear @ nearest.T
        adjustment = np.column_stack([stretch, shift - stretch @ shift])
        return TablePlane(rotation, translation, adjustment if self.kind == "affine" else np.eye(2, 3))

    def to_document(self) -> dict[str, object]:
        """Return what goes into the calibration file."""
        return {
            "kind": self.kind,
            "points": [{"point": name, "residual_mm": value} for name, value in self.residuals],
            "residual_mm": self.residual_mm,
            "holdout_mm": self.holdout_mm,
            "scale_ppm": self.scale_ppm,
        }


def fit_touch(plane_xy: Points, touches: Sequence[Touch], *, affine: bool | None = None) -> TouchFit:
    """Return the fit of touched points that the pictures saw at ``plane_xy`` (n, 2).  Raises CalibrationError."""
    robot_xy = np.array([(t.x_mm, t.y_mm) for t in touches])
    if len(touches) < 3:
        raise CalibrationError(
            f"{len(touches)} touched points do not give a frame: touch at least 3, far apart (9 in a 3x3 grid are good)"
        )
    spread = np.linalg.svd(plane_xy - plane_xy.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        raise CalibrationError(
            "the touched points lie almost on one line: touch points that span the work area in both directions"
        )
    if affine and len(touches) < 4:
        raise CalibrationError(
            f"{len(touches)} touched points leave nothing to check an affine fit with: touch at least 4"
        )
    if np.linalg.det(_affine(plane_xy, robot_xy)[:, :2]) < 0.0:
        raise CalibrationError(
            "the touched points are mirrored against what the camera saw: are x and y, or column and row, swapped?"
        )
    rigid_out = _holdout(plane_xy, robot_xy, affine=False)
    affine_out = _holdout(plane_xy, robot_xy, affine=True) if len(touches) >= 4 else np.inf
    if affine is None:
        affine = len(touches) >= AFFINE_MIN_POINTS and affine_out < AFFINE_GAIN * rigid_out
    matrix = _affine(plane_xy, robot_xy) if affine else _rigid(plane_xy, robot_xy)
    errors = np.linalg.norm(plane_xy @ matrix[:, :2].T + matrix[:, 2] - robot_xy, axis=1)
    scale = float(np.sqrt(abs(np.linalg.det(_affine(plane_xy, robot_xy)[:, :2]))))
    holdout = float(affine_out if affine else rigid_out)
    warnings = _warnings(touches, errors, scale, holdout, len(touches))
    names = [t.source for t in touches]
    return TouchFit(
        "affine" if affine else "rigid",
        matrix,
        tuple(zip(names, errors.tolist(), strict=True)),
        float(np.sqrt((errors * errors).mean())),
        holdout,
        (scale - 1.0) * 1e6,
        warnings,
    )


def _warnings(touches: Sequence[Touch], errors: Points, scale: float, holdout_mm: float, count: int) -> tuple[str, ...]:
    lines: list[str] = []
    if abs(scale - 1.0) > 0.01:
        lines.append(
            f"the robot's millimetres are {(scale - 1) * 100:+.1f} % off the board's: is the board's square as it "
            "was given?"
        )
    if holdout_mm > 1.0:
        lines.append(f"touched points disagree by {holdout_mm:.2f} mm: check the tool's tip and the points' order")
    worst = int(np.argmax(errors))
    rest = np.delete(errors, worst)
    if count >= 5 and errors[worst] > max(4.0 * float(np.median(rest)), 0.2):
        lines.append(f"{touches[worst].source}: {errors[worst]:.2f} mm off while the others agree: touch it again")
    if count == 3:
        lines.append(
            "3 touched points determine the frame, but leave nothing to check it with: 9 in a 3x3 grid are good"
        )
    return tuple(lines)


def _rigid(source: Points, target: Points) -> Points:
    """Return the rotation and shift (2, 3) without reflection that takes ``source`` to ``target`` best."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - b).T @ (source - a))
    turn = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    return np.column_stack([turn, b - turn @ a])


def _affine(source: Points, target: Points) -> Points:
    rows = np.column_stack([source, np.ones(len(source))])
    return np.asarray(np.linalg.lstsq(rows, target, rcond=None)[0], np.float64).T


def _holdout(source: Points, target: Points, *, affine: bool) -> float:
    fit = _affine if affine else _rigid
    errors: list[float] = []
    for i in range(len(source)):
        keep = np.arange(len(source)) != i
        matrix = fit(source[keep], target[keep])
        errors.append(float(np.sum((matrix[:, :2] @ source[i] + matrix[:, 2] - target[i]) ** 2)))
    return float(np.sqrt(np.mean(errors)))


def load_touch(path: Path) -> list[Touch]:
    """Return the touched points of a CSV file.  Raises CalibrationError that names file, line and column."""
    header, rows = read_rows(path, "image,column,row,x,y", "column,row,x,y", "u,v,x,y")
    touches: list[Touch] = []
    for number, row in enumerate(rows, 1):
        name, x, y = f"point {number}", row.number("x", MAX_MM), row.number("y", MAX_MM)
        if header == "u,v,x,y":
            touches.append(Touch(name, x, y, pixel=(row.number("u", MAX_PX), row.number("v", MAX_PX))))
        else:
            corner = (row.count("column", MAX_COUNT), row.count("row", MAX_COUNT))
            touches.append(Touch(name, x, y, row.text("image"), corner))
    return touches
