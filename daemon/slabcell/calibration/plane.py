"""Where is the work plane, and which frame does it carry?  From pictures of a board that lies on the table.

Several positions of the board are taken together: all of them lie in one plane, which determines the plane far better
than one position does, and what they show of the lens refines it within the uncertainty that `camera` left.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from slabcell.calibration.boards import Board
from slabcell.calibration.detection import Detection, best_variant
from slabcell.calibration.model import Calibration, Lens, TablePlane
from slabcell.calibration.projection import Vector, board_pose, from_vector, project, rms_length, to_vector
from slabcell.calibration.touch import Touch, TouchFit, fit_touch
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["PlaneResult", "PlaneView", "calibrate_plane"]

MAX_ROUNDS = 30
NOISE_FLOOR_PX = 0.02
LIFT_LIMIT_MM = 1.0
MIN_TO_TELL = 4
OUTLIER_FACTOR, OUTLIER_FLOOR_PX = 3.0, 0.3


@dataclass(frozen=True, slots=True)
class PlaneView:
    """One board position: residual in px and mm, and how the board alone would stand in the common plane."""

    name: str
    points: int
    rms_px: float
    rms_mm: float
    lift_mm: float
    tilt_deg: float


@dataclass(frozen=True, slots=True, eq=False)
class PlaneResult:
    """A calibration with its table plane, and what a person needs to judge it."""

    calibration: Calibration
    views: tuple[PlaneView, ...]
    rms_px: float
    touch: TouchFit | None
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Table pose (6,), lens, and where each board lies on the table: x, y in mm, turn in rad; the first is fixed."""

    pose: Vector
    lens: Lens
    boards: npt.NDArray[np.float64]


def calibrate_plane(
    calibration: Calibration,
    detections: Sequence[Detection],
    board: Board,
    *,
    board_thickness_mm: float = 0.0,
    touch: Sequence[Touch] = (),
    affine: bool | None = None,
) -> PlaneResult:
    """Return the calibration with the table plane that the board positions show.

    The first picture's board gives origin and axes of the table unless points were touched: x and y are then the
    robot's.  The board's printed face is ``board_thickness_mm`` above the table.  ``affine`` lets touched points scale
    and skew the frame; None decides by the hold-out residual.  Raises CalibrationError.
    """
    if not detections:
        raise CalibrationError("no picture shows the board on the table; at least one must")
    if not 0.0 <= board_thickness_mm <= 200.0:
        raise CalibrationError(f"a board thickness of {board_thickness_mm:g} mm is outside 0 mm to 200 mm")
    for view in detections:
        calibration.require_size(view.width, view.height, view.name)
    root, noise_px = _prior(calibration)

    def solve(views: Sequence[Detection]) -> _State:
        poses = [board_pose(d.points_mm, d.pixels, calibration.lens) for d in views]
        return _refine(_start(calibration.lens, poses, board_thickness_mm), views, board_thickness_mm, root, noise_px)

    def residual(views: Sequence[Detection]) -> float:
        return _cost(solve(views), views, board_thickness_mm, None, noise_px, np.zeros(0))

    detections = [d.centred(calibration.lens) for d in best_variant(detections, residual)]
    left_out: list[Detection] = []
    while True:
        state = solve(detections)
        done = _with_plane(calibration, state)
        views = _reports(done, state, detections, board_thickness_mm)
        worst = _outlier(views)
        if worst is None:
            break
        left_out.append(detections[worst])
        detections = [d for n, d in enumerate(detections) if n != worst]
    rms_px = float(np.sqrt(np.mean([v.rms_px**2 for v in views])))
    warnings = _warnings(done, views, left_out, board_thickness_mm)
    fit: TouchFit | None = None
    if touch:
        seen = [_touched_on_plane(done, t, detections, state, board, board_thickness_mm) for t in touch]
        fit = fit_touch(np.array(seen), touch, affine=affine)
        done = replace(done, plane=fit.carry(done.require_plane()))
        warnings += fit.warnings
    diagnostics: dict[str, object] = {
        **done.diagnostics,
        "plane": {
            "board": str(board),
            "board_thickness_mm": board_thickness_mm,
            "rms_px": rms_px,
            "views": [
                {"name": v.name, "rms_px": v.rms_px, "rms_mm": v.rms_mm, "lift_mm": v.lift_mm, "tilt_deg": v.tilt_deg}
                for v in views
            ],
            "touch": fit.to_document() if fit else None,
            "warnings": list(warnings),
        },
    }
    return PlaneResult(replace(done, diagnostics=diagnostics), views, rms_px, fit, warnings)


def _with_plane(calibration: Calibration, state: _State) -> Calibration:
    turn, _ = cv2.Rodrigues(state.pose[:3])
    plane = TablePlane(np.asarray(turn, np.float64), state.pose[3:].copy())
    if plane.rotation[2, 2] > 0.0:
        raise CalibrationError(
            "the table would be seen from below: the pictures seem to be mirrored; save them as the camera gives them"
        )
    return replace(calibration, lens=state.lens, plane=plane)


def _outlier(views: Sequence[PlaneView]) -> int | None:
    """Return the view that does not lie in the plane of the others, if there are enough to tell.

    The first is never left out, because it carries the frame.
    """
    if len(views) < MIN_TO_TELL:
        return None
    worst = max(range(len(views)), key=lambda n: views[n].rms_px)
    typical = float(np.median([v.rms_px for v in views]))
    return worst if worst and views[worst].rms_px > max(OUTLIER_FACTOR * typical, OUTLIER_FLOOR_PX) else None


def _start(lens: Lens, poses: Sequence[Vector], thickness_mm: float) -> _State:
    first, _ = cv2.Rodrigues(poses[0][:3])
    boards = np.zeros((len(poses), 3))
    for n, pose in enumerate(poses[1:], 1):
        turn, _ = cv2.Rodrigues(pose[:3])
        relative = first.T @ turn
        boards[n, :2] = (first.T @ (pose[3:] - poses[0][3:]))[:2]
        boards[n, 2] = np.arctan2(relative[1, 0], relative[0, 0])
    table = poses[0].copy()
    table[3:] -= first @ (0.0, 0.0, thickness_mm)
    return _State(table, lens, boards)


def _on_table(points_mm: Points, place: Vector, height_mm: float) -> Points:
    c, s = np.cos(place[2]), np.sin(place[2])
    x, y = points_mm[:, 0], points_mm[:, 1]
    return np.column_stack([c * x - s * y + place[0], s * x + c * y + place[1], np.full(len(x), height_mm)])


def _prior(calibration: Calibration) -> tuple[Points | None, float]:
    """Return the square root of the information on the intrinsics, (k, k), if the file has it, and the noise in px."""
    size = len(to_vector(calibration.lens))
    noise = calibration.diagnostics.get("noise_px")
    noise_px = max(float(noise), NOISE_FLOOR_PX) if isinstance(noise, int | float) else 0.1
    covariance = calibration.diagnostics.get("covariance")
    if covariance is None:
        return None, noise_px
    matrix = np.array(covariance, dtype=np.float64)
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        raise CalibrationError(
            f"the calibration's covariance has the shape {matrix.shape}, not {(size, size)}: calibrate the camera again"
        )
    # Scaled to unit diagonal first, because pixels and distortion coefficients differ by orders of magnitude.
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-18))
    values, axes = np.linalg.eigh((matrix + matrix.T) / 2.0 / np.outer(scale, scale))
    return (axes / np.sqrt(np.maximum(values, 1e-9))).T / scale, noise_px


def _refine(
    state: _State, views: Sequence[Detection], thickness_mm: float, root: Points | None, noise_px: float
) -> _State:
    """Return the state of least squared residuals (Levenberg-Marquardt; the prior keeps the lens in bounds)."""
    before = to_vector(state.lens)
    cost = _cost(state, views, thickness_mm, root, noise_px, before)
    damping = 1e-6
    for _ in range(MAX_ROUNDS):
        normal, gradient = _normal_equations(state, views, thickness_mm, root, noise_px, before)
        scaled = normal + damping * np.diag(np.diag(normal) + 1e-12)
        step = np.asarray(np.linalg.lstsq(scaled, gradient, rcond=1e-14)[0], np.float64)
        trial = _moved(state, step, free_lens=root is not None)
        trial_cost = _cost(trial, views, thickness_mm, root, noise_px, before)
        if trial_cost < cost:
            settled = cost - trial_cost < 1e-9 * max(cost, 1.0)
            state, cost, damping = trial, trial_cost, damping / 10.0
            if settled:
                break
        else:
            damping *= 100.0
            if damping > 1e6:
                break
    return state


def _moved(state: _State, step: Vector, *, free_lens: bool) -> _State:
    boards = state.boards.copy()
    boards[1:] += step[6 : 6 + 3 * (len(boards) - 1)].reshape(-1, 3)
    vector = to_vector(state.lens)
    if free_lens:
        vector = vector + step[-len(vector) :]
    return _State(state.pose + step[:6], from_vector(vector, state.lens), boards)


def _cost(
    state: _State, views: Sequence[Detection], thickness_mm: float, root: Points | None, noise_px: float, before: Vector
) -> float:
    total = 0.0
    for view, place in zip(views, state.boards, strict=True):
        pixels, _, _ = project(_on_table(view.points_mm, place, thickness_mm), state.pose, state.lens)
        total += float(np.sum((view.pixels - pixels) ** 2)) / noise_px**2
    if root is not None:
        total += float(np.sum((root @ (to_vector(state.lens) - before)) ** 2))
    return total


def _normal_equations(
    state: _State, views: Sequence[Detection], thickness_mm: float, root: Points | None, noise_px: float, before: Vector
) -> tuple[Points, Vector]:
    turn, _ = cv2.Rodrigues(state.pose[:3])
    vector = to_vector(state.lens)
    lens_size = len(vector) if root is not None else 0
    size = 6 + 3 * (len(views) - 1) + lens_size
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    for n, (view, place) in enumerate(zip(views, state.boards, strict=True)):
        points = _on_table(view.points_mm, place, thickness_mm)
        pixels, by_pose, by_lens = project(points, state.pose, state.lens)
        jacobian = np.zeros((2 * len(points), size))
        jacobian[:, :6] = by_pose
        if n:
            by_point = by_pose[:, 3:].reshape(-1, 2, 3) @ turn
            swing = np.column_stack([-(points[:, 1] - place[1]), points[:, 0] - place[0]])
            at = 6 + 3 * (n - 1)
            jacobian[:, at : at + 2] = by_point[:, :, :2].reshape(-1, 2)
            jacobian[:, at + 2] = np.einsum("nij,nj->ni", by_point[:, :, :2], swing).ravel()
        if lens_size:
            jacobian[:, -lens_size:] = by_lens
        normal += jacobian.T @ jacobian / noise_px**2
        gradient += jacobian.T @ (view.pixels - pixels).ravel() / noise_px**2
    if root is not None:
        normal[-lens_size:, -lens_size:] += root.T @ root
        gradient[-lens_size:] -= root.T @ (root @ (vector - before))
    return normal, gradient


def _reports(
    done: Calibration, state: _State, views: Sequence[Detection], thickness_mm: float
) -> tuple[PlaneView, ...]:
    reports: list[PlaneView] = []
    for view, place in zip(views, state.boards, strict=True):
        on_table = _on_table(view.points_mm, place, thickness_mm)
        residual = view.pixels - done.image_from_table(on_table[:, :2], thickness_mm)
        seen = done.table_from_image(view.pixels, thickness_mm)
        lift, lean = _stands(done, view, thickness_mm)
        reports.append(
            PlaneView(
                view.name,
                len(view.pixels),
                rms_length(residual),
                rms_length(seen - on_table[:, :2]),
                lift,
                lean,
            )
        )
    return tuple(reports)


def _stands(done: Calibration, view: Detection, thickness_mm: float) -> tuple[float, float]:
    """Return how far a board, taken alone, stands off the plane (mm) and how it is tilted against it (degrees)."""
    plane = done.require_plane()
    alone = board_pose(view.points_mm, view.pixels, done.lens)
    turn, _ = cv2.Rodrigues(alone[:3])
    middle = turn @ view.points_mm.mean(axis=0) + alone[3:]
    lift = float((plane.rotation.T @ (middle - plane.translation))[2]) - thickness_mm
    return lift, float(np.rad2deg(np.arccos(np.clip((plane.rotation.T @ turn)[2, 2], -1.0, 1.0))))


def _warnings(
    done: Calibration, views: Sequence[PlaneView], left_out: Sequence[Detection], thickness_mm: float
) -> tuple[str, ...]:
    lines: list[str] = []
    if len(views) < 3:
        lines.append(
            f"{len(views)} board position(s) on the table: five, spread over the work area, give several times the"
            " accuracy"
        )
    for view in left_out:
        lift, tilt = _stands(done, view, thickness_mm)
        lines.append(
            f"{view.name} was left out: the board does not lie in the plane of the others (it stands {lift:+.2f} mm "
            "off,"
            f" tilted by {tilt:.2f}°): lay it flat and take the picture again"
        )
    typical = float(np.median([v.rms_px for v in views]))
    if len(views) > 1:
        lines += [
            f"{v.name}: the board does not lie in the plane of the others (residual {v.rms_px:.2f} px, alone it would"
            f" stand {v.lift_mm:+.2f} mm off, tilted by {v.tilt_deg:.2f}°): lay it flat and take the picture again"
            for v in views
            if v.rms_px > max(OUTLIER_FACTOR * typical, OUTLIER_FLOOR_PX) or abs(v.lift_mm) > LIFT_LIMIT_MM
        ]
    return tuple(lines)


def _touched_on_plane(
    done: Calibration, touch: Touch, views: Sequence[Detection], state: _State, board: Board, thickness_mm: float
) -> tuple[float, float]:
    """Return x, y on the rigid plane of a touched board point or mark."""
    if touch.pixel is not None:
        x, y = done.table_from_image(np.array([touch.pixel]))[0]
        return float(x), float(y)
    names = [v.name for v in views]
    matches = [n for n, name in enumerate(names) if touch.image in ("", name) or name.endswith("/" + touch.image)]
    if not matches:
        raise CalibrationError(f"{touch.source}: image {touch.image!r} is not among the pictures: {', '.join(names)}")
    columns, rows = board.grid
    column, row = touch.corner
    if not (0 <= column < columns and 0 <= row < rows):
        raise CalibrationError(
            f"{touch.source}: corner {column},{row} is outside {columns}x{rows} of {board}; the first is 0,0"
        )
    point = board.points[row * columns + column]
    x, y, _ = _on_table(point[None], state.boards[matches[0]], thickness_mm)[0]
    return float(x), float(y)
