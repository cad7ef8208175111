"""What lens does this camera have?  Zhang's method on pictures of a board, and how far its answer may be trusted.

Sources: Z. Zhang, "A flexible new technique for camera calibration", PAMI 22(11), 2000 (the method, solved by OpenCV);
the standard deviations come from the normal equations of all views together, with the views' own poses eliminated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from slabcell.calibration.boards import Board
from slabcell.calibration.coverage import Coverage, measure_coverage
from slabcell.calibration.detection import Detection, best_variant
from slabcell.calibration.model import Calibration, CameraIdentity, Lens
from slabcell.calibration.projection import (
    Vector,
    board_pose,
    from_vector,
    parameter_names,
    project,
    rms_length,
    to_vector,
)
from slabcell.errors import CalibrationError
from slabcell.geometry import Points

__all__ = ["CameraResult", "LensModel", "ViewReport", "calibrate_camera"]

LensModel = Literal["brown4", "brown5", "brown8", "brown14", "fisheye"]

MIN_VIEWS = 4
MIN_POINTS = 8
OUTLIER_FACTOR = 3.0
MAX_FOLDS = 15
OUTLIER_FLOOR_PX = 0.15
NOISE_FLOOR_PX = 0.02
MAX_FOCAL_UNCERTAINTY = 0.1
"""Standard deviation of the focal length, relative to it, above which there is no calibration."""

# OpenCV's flags, and how many coefficients the model has.
_MODELS: dict[str, tuple[int, int]] = {
    "brown4": (cv2.CALIB_FIX_K3, 4),
    "brown5": (0, 5),
    "brown8": (cv2.CALIB_RATIONAL_MODEL, 8),
    "brown14": (cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL | cv2.CALIB_TILTED_MODEL, 14),
    "fisheye": (cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW, 4),
}


@dataclass(frozen=True, slots=True)
class ViewReport:
    """How well one picture agrees with the lens.  ``used`` is False for a view that was left out as an outlier."""

    name: str
    points: int
    rms_px: float
    used: bool
    tilt_deg: float
    distance_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class CameraResult:
    """A calibration of the lens, and everything a person needs to judge it.

    ``holdout_px``: residual of views in a lens that was found without them.  ``focal_distance_correlation``: how far a
    longer focal length can pass for a longer distance (1: not told apart).  ``residuals`` (n, 4): u, v and what is
    left.
    """

    calibration: Calibration
    rms_px: float
    holdout_px: float
    focal_distance_correlation: float
    views: tuple[ViewReport, ...]
    coverage: Coverage
    residuals: Points
    std: dict[str, float]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    lens: Lens
    poses: list[Vector]
    residuals: list[Points]

    @property
    def view_rms(self) -> Vector:
        return np.array([rms_length(r) for r in self.residuals])

    @property
    def rms(self) -> float:
        return rms_length(np.vstack(self.residuals))


def calibrate_camera(
    detections: Sequence[Detection],
    board: Board,
    *,
    model: LensModel = "brown5",
    serial: str = "",
    offset: tuple[int, int] = (0, 0),
    binning: int = 1,
    holdout: bool = True,
) -> CameraResult:
    """Return the lens that explains the views best.

    Views whose residual is far above the others' are named and left out.  The result is bound to the camera's serial
    number, and to the pictures' size, region (``offset``) and ``binning``.  ``holdout`` False saves the time to
    find the hold-out residual.  Raises CalibrationError if there are fewer than four usable views, if they differ in
    size, or if they do not determine a lens.
    """
    views = [d for d in detections if len(d.pixels) >= MIN_POINTS]
    size = _common_size(views)
    views = best_variant(views, lambda trial: float(np.median(_solve(trial, model, size).view_rms)))
    views = _centre_discs(views, model, size)
    used = list(range(len(views)))
    solution = _solve(views, model, size)
    for _ in range(3):
        bad = _outliers(solution.view_rms)
        if not len(bad) or len(used) - len(bad) < max(MIN_VIEWS, 2 * len(views) // 3):
            break
        used = [i for n, i in enumerate(used) if n not in bad]
        solution = _solve([views[i] for i in used], model, size)
    information, noise_px = _information([views[i] for i in used], solution)
    covariance = _inverse(information) * noise_px**2
    names = parameter_names(solution.lens)
    std = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    focal = float(solution.lens.matrix[0, 0])
    if std["fx"] * max(1.0, NOISE_FLOOR_PX / noise_px) > MAX_FOCAL_UNCERTAINTY * focal:
        raise CalibrationError(
            f"the views leave the focal length open ({focal:.0f} ± {std['fx']:.0f} px): add views that are tilted by 20"
            " to 45 degrees in different directions"
        )
    kept = [views[i] for i in used]
    holdout_px = _holdout(kept, model, size, solution.lens) if holdout else float("nan")
    focal_distance = _focal_distance_correlation([views[i] for i in used], solution, covariance, noise_px)
    reports = _reports(views, used, solution)
    coverage = measure_coverage([views[i] for i in used])
    warnings = _warnings(views, used, reports, solution, coverage, std, holdout_px, board)
    diagnostics: dict[str, object] = {
        "method": "zhang",
        "lens_model": model,
        "board": str(board),
        "rms_px": solution.rms,
        "holdout_px": holdout_px if np.isfinite(holdout_px) else None,
        "noise_px": noise_px,
        "focal_distance_correlation": focal_distance,
        "views": [
            {"name": r.name, "points": r.points, "rms_px": r.rms_px, "used": r.used, "tilt_deg": r.tilt_deg}
            for r in reports
        ],
        "std": std,
        "covariance": covariance.tolist(),
        "coverage": {"hull_fraction": coverage.hull_fraction, "reach_fraction": coverage.reach_fraction},
        "warnings": list(warnings),
    }
    binding = CameraIdentity(*size, serial, *offset, binning)
    calibration = Calibration(binding, solution.lens, None, diagnostics)
    residuals = np.vstack([np.hstack([views[i].pixels, r]) for i, r in zip(used, solution.residuals, strict=True)])
    return CameraResult(
        calibration, solution.rms, holdout_px, focal_distance, reports, coverage, residuals, std, warnings
    )


def _common_size(views: Sequence[Detection]) -> tuple[int, int]:
    if len(views) < MIN_VIEWS:
        raise CalibrationError(
            f"{len(views)} pictures show the board, at least {MIN_VIEWS} are needed (10 to 20 are good): show it tilted"
            " by 20 to 45 degrees in different directions, and near every corner of the picture"
        )
    sizes = {(v.width, v.height) for v in views}
    if len(sizes) > 1:
        odd = ", ".join(
            f"{v.name} {v.width}x{v.height}" for v in views if (v.width, v.height) != (views[0].width, views[0].height)
        )
        raise CalibrationError(
            f"the pictures differ in size: {views[0].name} has {views[0].width}x{views[0].height}, but {odd}"
        )
    return views[0].width, views[0].height


def _centre_discs(views: Sequence[Detection], model: LensModel, size: tuple[int, int]) -> list[Detection]:
    """Return the views with what perspective does to the centres of discs taken off, if they show discs."""
    if not any(v.disc_mm > 0.0 for v in views):
        return list(views)
    centred = list(views)
    for _ in range(2):
        solution = _solve(centred, model, size)
        centred = [v.centred(solution.lens, pose) for v, pose in zip(views, solution.poses, strict=True)]
    return centred


def _holdout(views: Sequence[Detection], model: LensModel, size: tuple[int, int], near: Lens) -> float:
    """Return the rms residual of views in lenses found without them; of many views several are left out at once.

    NaN where the lens hangs on a single view.
    """
    folds = min(len(views), MAX_FOLDS)
    if len(views) - -(-len(views) // folds) < MIN_VIEWS - 1:
        return float("nan")
    squares, count = 0.0, 0
    for fold in range(folds):
        try:
            lens = _solve([v for n, v in enumerate(views) if n % folds != fold], model, size, near).lens
        except CalibrationError:
            return float("nan")
        for view in views[fold::folds]:
            residual = view.pixels - project(view.points_mm, board_pose(view.points_mm, view.pixels, lens), lens)[0]
            squares, count = squares + float((residual * residual).sum()), count + len(residual)
    return float(np.sqrt(squares / count))


def _focal_distance_correlation(
    views: Sequence[Detection], solution: _Solution, covariance: Points, noise_px: float
) -> float:
    found: list[float] = []
    for view, pose in zip(views, solution.poses, strict=True):
        _, by_pose, by_lens = project(view.points_mm, pose, solution.lens)
        inner = np.asarray(np.linalg.inv(by_pose.T @ by_pose), np.float64)
        carried = -inner @ (by_pose.T @ by_lens)
        distance = float((noise_px**2 * inner + carried @ covariance @ carried.T)[5, 5])
        found.append(abs(float((carried @ covariance)[5, 0])) / np.sqrt(distance * float(covariance[0, 0])))
    return float(np.mean(found))


def _solve(views: Sequence[Detection], model: LensModel, size: tuple[int, int], near: Lens | None = None) -> _Solution:
    """Return lens and poses of least residual; ``near`` is a lens to start from."""
    points = [np.ascontiguousarray(v.points_mm.reshape(-1, 1, 3), dtype=np.float32) for v in views]
    pixels = [np.ascontiguousarray(v.pixels.reshape(-1, 1, 2), dtype=np.float32) for v in views]
    flags, coefficients = _MODELS[model]
    matrix, distortion = np.eye(3), np.zeros(5)
    if near is not None and model != "fisheye":
        matrix, distortion = near.matrix.copy(), near.distortion.copy()
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
    try:
        if model == "fisheye":
            _, matrix, distortion, turns, shifts = cv2.fisheye.calibrate(
                points, pixels, size, np.eye(3), np.zeros(4), flags=flags, criteria=stop
            )
        else:
            _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
                points, pixels, size, matrix, distortion, flags=flags, criteria=stop
            )
    except cv2.error as error:
        raise CalibrationError(
            f"the views do not determine a {model} lens ({error.err or 'no solution'}): add views that are tilted in "
            "different directions"
        ) from error
    lens = Lens(
        np.asarray(matrix, np.float64),
        np.asarray(distortion, np.float64).ravel()[:coefficients],
        "fisheye" if model == "fisheye" else "brown",
    )
    if not np.isfinite(to_vector(lens)).all() or min(lens.matrix[0, 0], lens.matrix[1, 1]) <= 0.0:
        raise CalibrationError(
            f"the views do not determine a {model} lens: add views that are tilted in different directions"
        )
    lens = from_vector(to_vector(lens), lens)
    poses = [np.concatenate([np.ravel(r), np.ravel(t)]).astype(np.float64) for r, t in zip(turns, shifts, strict=True)]
    residuals = [v.pixels - project(v.points_mm, pose, lens)[0] for v, pose in zip(views, poses, strict=True)]
    return _Solution(lens, poses, residuals)


def _outliers(view_rms: Vector) -> set[int]:
    limit = max(OUTLIER_FACTOR * float(np.median(view_rms)), OUTLIER_FLOOR_PX)
    return {int(i) for i in np.flatnonzero(view_rms > limit)}


def _information(views: Sequence[Detection], solution: _Solution) -> tuple[Points, float]:
    """Return what the views know of the intrinsics, for noise of 1 px, and the noise that their residuals show."""
    size = len(to_vector(solution.lens))
    information = np.zeros((size, size))
    for view, pose in zip(views, solution.poses, strict=True):
        _, by_pose, by_lens = project(view.points_mm, pose, solution.lens)
        cross = by_lens.T @ by_pose
        information += by_lens.T @ by_lens - cross @ np.linalg.solve(by_pose.T @ by_pose, cross.T)
    numbers = 2 * sum(len(v.pixels) for v in views)
    freedom = max(numbers - size - 6 * len(views), 1)
    noise_px = float(np.sqrt(sum(float(np.sum(np.square(r))) for r in solution.residuals) / freedom))
    return information, max(noise_px, 1e-6)


def _inverse(information: Points) -> Points:
    """Return the covariance; what the views do not tell gets a variance that is enormous, not zero."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
    values, axes = np.linalg.eigh(information / np.outer(scale, scale))
    covariance = (axes / np.maximum(values, 1e-14)) @ axes.T / np.outer(scale, scale)
    return (covariance + covariance.T) / 2.0


def _reports(views: Sequence[Detection], used: Sequence[int], solution: _Solution) -> tuple[ViewReport, ...]:
    reports: list[ViewReport] = []
    for i, view in enumerate(views):
        pose = solution.poses[used.index(i)] if i in used else board_pose(view.points_mm, view.pixels, solution.lens)
        residual = view.pixels - project(view.points_mm, pose, solution.lens)[0]
        turn, _ = cv2.Rodrigues(pose[:3])
        tilt = float(np.rad2deg(np.arccos(np.clip(abs(turn[2, 2]), 0.0, 1.0))))
        rms = rms_length(residual)
        reports.append(ViewReport(view.name, len(view.pixels), rms, i in used, tilt, float(np.linalg.norm(pose[3:]))))
    return tuple(reports)


def _warnings(
    views: Sequence[Detection],
    used: Sequence[int],
    reports: Sequence[ViewReport],
    solution: _Solution,
    coverage: Coverage,
    std: dict[str, float],
    holdout_px: float,
    board: Board,
) -> tuple[str, ...]:
    lines = [
        f"{r.name} was left out: its residual of {r.rms_px:.2f} px is far above the others'; is the board bent, "
        "blurred or moving in it?"
        for r in reports
        if not r.used
    ]
    tilts = [r.tilt_deg for r in reports if r.used]
    if max(tilts) < 15.0:
        lines.append(
            f"no view is tilted by more than {max(tilts):.0f}°: focal length and distance cannot be told apart; tilt "
            "the board by 20° to 45°"
        )
    if holdout_px > 2.0 * solution.rms:
        lines.append(
            f"views that were left out fit with {holdout_px:.2f} px instead of {solution.rms:.2f} px: take more "
            "pictures, or"
            " a lens model with fewer coefficients"
        )
    if len(used) < 8:
        lines.append(f"only {len(used)} views: 10 to 20 give a lens that can be trusted at the rim")
    lines += coverage.warnings()
    focal = solution.lens.matrix[0, 0]
    if std["fx"] > 0.005 * focal:
        lines.append(f"the focal length of {focal:.0f} px is uncertain by {std['fx']:.1f} px: add tilted views")
    if solution.rms > 0.5:
        lines.append(
            f"the residual of {solution.rms:.2f} px is large: check that {board} is the board, that it is flat and "
            "the pictures are sharp"
        )
    lines += [f"{v.name}: {v.note}" for v in views if v.note]
    return tuple(lines)
