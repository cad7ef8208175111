"""Does a calibration still hold?  One new picture of the board, or of marks that never move, tells how far it drifted.

A board anywhere in view shows whether the lens is as it was; lying on the table, whether the camera's height and tilt
are. Whether the camera moved sideways only something fixed can show: the board left where it was in an older picture,
or marks on the table.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.boards import Board
from slabcell.calibration.csv_file import read_rows
from slabcell.calibration.detection import Detection, Picture, to_grey
from slabcell.calibration.model import Calibration
from slabcell.calibration.projection import board_pose, project, rms_length
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["BoardCheck", "Drift", "check_board", "drift_of_board", "drift_of_marks", "load_marks"]

LENS_FACTOR, LENS_FLOOR_PX = 3.0, 0.15
PATCH_PX, SEARCH_PX = 24, 40
MIN_CORRELATION = 0.7
MAX_MARKS = 200
MAX_PX = 1e5


@dataclass(frozen=True, slots=True)
class BoardCheck:
    """What one board says: the residual of its corners and, if the table is known, how it lies on it.

    ``scale_ppm``: how much larger than true the board seems on the table.  ``problems`` are words for a person.
    """

    lens_rms_px: float
    calibrated_rms_px: float | None
    lift_mm: float | None
    tilt_deg: float | None
    scale_ppm: float | None
    problems: tuple[str, ...]

    def to_document(self) -> dict[str, object]:
        """Return the check as JSON values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Drift:
    """How fixed points moved between two pictures, on the table: a shift in mm, a turn in degrees, a scale.

    ``worst_mm`` is the largest movement of a single point, ``residual_mm`` what shift, turn and scale leave over (rms).
    """

    points: int
    x_mm: float
    y_mm: float
    turn_deg: float
    scale_ppm: float
    mean_mm: float
    worst_mm: float
    residual_mm: float

    def to_document(self) -> dict[str, object]:
        """Return the drift as JSON values."""
        return asdict(self)


def check_board(
    calibration: Calibration,
    detection: Detection,
    board: Board,
    *,
    board_thickness_mm: float = 0.0,
    limit_mm: float = 0.2,
) -> BoardCheck:
    """Return what a board lying on the table, or held anywhere if no table is known, says of the calibration."""
    calibration.require_size(detection.width, detection.height, detection.name)
    view = detection.centred(calibration.lens)
    pose = board_pose(view.points_mm, view.pixels, calibration.lens)
    residual = rms_length(view.pixels - project(view.points_mm, pose, calibration.lens)[0])
    before = calibration.diagnostics.get("rms_px")
    usual = float(before) if isinstance(before, int | float) else None
    problems: list[str] = []
    limit = max(LENS_FACTOR * (usual or 0.0), LENS_FLOOR_PX)
    if residual > limit:
        problems.append(
            f"{detection.name}: the corners of {board} are {residual:.2f} px off, the limit is {limit:.2f} px: focus "
            "or lens have"
            " changed, or the board is bent; calibrate the camera again"
        )
    plane = calibration.plane
    if plane is None:
        return BoardCheck(residual, usual, None, None, None, tuple(problems))
    turn, _ = cv2.Rodrigues(pose[:3])
    turn = np.asarray(turn, np.float64)
    middle = turn @ view.points_mm.mean(axis=0) + pose[3:]
    lift = float((plane.rotation.T @ (middle - plane.translation))[2]) - board_thickness_mm
    tilt = float(np.rad2deg(np.arccos(np.clip((plane.rotation.T @ turn)[2, 2], -1.0, 1.0))))
    seen = calibration.table_from_image(view.pixels, board_thickness_mm)
    scale = _motion(view.points_mm[:, :2], seen)[2]
    reach = float(np.linalg.norm(np.ptp(view.points_mm[:, :2], axis=0)))
    across = abs(scale - 1.0) * reach
    if across > limit_mm:
        problems.append(
            f"{detection.name}: the board measures {(scale - 1.0) * reach:+.2f} mm over its {reach:.0f} mm, the "
            f"limit is {limit_mm:g} mm"
            f" (it seems to lie {lift:+.1f} mm off the table): the camera's height has changed; calibrate the plane "
            "again"
        )
    if reach * np.sin(np.deg2rad(tilt)) > 10.0 * limit_mm:
        problems.append(
            f"{detection.name}: the board seems tilted by {tilt:.2f}° against the table: the camera was turned; "
            "calibrate the"
            " plane again"
        )
    return BoardCheck(residual, usual, lift, tilt, (scale - 1.0) * 1e6, tuple(problems))


def drift_of_board(
    calibration: Calibration, before: Detection, now: Detection, *, board_thickness_mm: float = 0.0
) -> Drift:
    """Return how a board that was not touched seems to have moved between two pictures."""
    for view in (before, now):
        calibration.require_size(view.width, view.height, view.name)
    common, at_before, at_now = np.intersect1d(before.indices, now.indices, return_indices=True)
    if len(common) < 4:
        raise CalibrationError(
            f"{before.name} and {now.name} have {len(common)} points of the board in common; 4 are needed"
        )
    then, after = before.centred(calibration.lens), now.centred(calibration.lens)
    return _drift(
        calibration.table_from_image(then.pixels[at_before], board_thickness_mm),
        calibration.table_from_image(after.pixels[at_now], board_thickness_mm),
    )


def drift_of_marks(
    calibration: Calibration, before: Picture, now: Picture, marks: Sequence[tuple[float, float]]
) -> tuple[Drift, list[str]]:
    """Return how marks at pixels of the older picture moved, and a line for each that is not found again.

    A mark is whatever has contrast within 24 px around its pixel, on the table's own surface.  Raises CalibrationError
    if fewer than two are found.
    """
    old, new = to_grey(before, "the older picture"), to_grey(now, "the new picture")
    for picture, name in ((old, "the older picture"), (new, "the new picture")):
        calibration.require_size(picture.shape[1], picture.shape[0], name)
    if len(marks) > MAX_MARKS:
        raise CalibrationError(f"{len(marks)} marks are more than {MAX_MARKS}; a dozen is plenty")
    found: list[tuple[tuple[float, float], tuple[float, float]]] = []
    failures: list[str] = []
    for u, v in marks:
        place = _follow(old, new, u, v)
        if isinstance(place, str):
            failures.append(f"mark at {u:.0f},{v:.0f}: {place}")
        else:
            found.append(((u, v), place))
    if len(found) < 2:
        raise CalibrationError("fewer than two marks are found again: " + ("; ".join(failures) or "no mark was given"))
    pixels = np.array(found)
    return _drift(calibration.table_from_image(pixels[:, 0]), calibration.table_from_image(pixels[:, 1])), failures


def load_marks(path: Path) -> list[tuple[float, float]]:
    """Return the pixels of marks from a CSV file with the header ``u,v``.  Raises CalibrationError."""
    _, rows = read_rows(path, "u,v")
    return [(row.number("u", MAX_PX), row.number("v", MAX_PX)) for row in rows]


def _follow(old: npt.NDArray[np.uint8], new: npt.NDArray[np.uint8], u: float, v: float) -> tuple[float, float] | str:
    """Return where the surroundings of a pixel are in the new picture, or why they are not found."""
    column, row = round(u), round(v)
    height, width = old.shape
    if not (PATCH_PX <= column < width - PATCH_PX and PATCH_PX <= row < height - PATCH_PX):
        return f"is within {PATCH_PX} px of the picture's rim"
    patch = old[row - PATCH_PX : row + PATCH_PX + 1, column - PATCH_PX : column + PATCH_PX + 1]
    if float(patch.std()) < 3.0:
        return "has no contrast around it"
    top, left = max(row - PATCH_PX - SEARCH_PX, 0), max(column - PATCH_PX - SEARCH_PX, 0)
    area = new[top : row + PATCH_PX + SEARCH_PX + 1, left : column + PATCH_PX + SEARCH_PX + 1]
    match = cv2.matchTemplate(area, patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (x, y) = cv2.minMaxLoc(match)
    if best < MIN_CORRELATION:
        return f"is not found within {SEARCH_PX} px (correlation {best:.2f}, at least {MIN_CORRELATION})"
    warp = np.array([[1.0, 0.0, x], [0.0, 1.0, y]], np.float32)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-5)
    everywhere = np.full(area.shape, 255, np.uint8)
    try:
        _, refined = cv2.findTransformECC(patch, area, warp, cv2.MOTION_TRANSLATION, stop, everywhere, 3)
    except cv2.error:
        return "is found, but not to a part of a pixel"
    shift = np.asarray(refined, np.float64)[:, 2]
    return float(left + shift[0] + PATCH_PX + u - column), float(top + shift[1] + PATCH_PX + v - row)


def _motion(source: Points, target: Points) -> tuple[Points, float, float]:
    """Return the similarity from ``source`` to ``target``, both (n, 2): shift of the middle, turn in rad, scale."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    along = float((a * b).sum())
    across = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    scale = float(np.hypot(along, across)) / max(float((a * a).sum()), 1e-12)
    shift: Points = np.asarray(target.mean(axis=0) - source.mean(axis=0), np.float64)
    return shift, float(np.arctan2(across, along)), scale


def _drift(before: Points, now: Points) -> Drift:
    shift, turn, scale = _motion(before, now)
    centred = before - before.mean(axis=0)
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    moved = centred @ np.array([[c, s], [-s, c]]) + before.mean(axis=0) + shift
    apart = np.linalg.norm(now - before, axis=1)
    return Drift(
        len(before),
        float(shift[0]),
        float(shift[1]),
        float(np.rad2deg(turn)),
        (scale - 1.0) * 1e6,
        float(apart.mean()),
        float(apart.max()),
        rms_length(now - moved),
    )
