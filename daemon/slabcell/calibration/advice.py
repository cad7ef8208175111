"""Which picture of the board is missing yet?  Advice while views are collected, before anything is computed.

What is said of tilts needs a lens; without one that the camera has, a focal length is guessed, which is good enough to
tell 10° from 30°.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from slabcell.calibration.coverage import Coverage, measure_coverage
from slabcell.calibration.detection import Detection
from slabcell.calibration.handeye.motion import Array, kuka_matrix, rotation_log
from slabcell.calibration.handeye.stations import RobotPose
from slabcell.calibration.model import Lens
from slabcell.calibration.projection import board_pose

__all__ = ["Advice", "Kind", "Stand", "Survey", "survey"]

Kind = Literal["camera", "plane", "hand-eye"]

ENOUGH = {"camera": 10, "plane": 5, "hand-eye": 15}
"""Views that are good; fewer are possible."""
TILTED_DEG, TILTED_VIEWS = 15.0, 4
NEAR_AND_FAR = 1.15
FLAT_DEG = 1.0
TURNED_DEG, AXIS_SPREAD = 30.0, 0.25
TWIN_DEG, TWIN_MM = 3.0, 10.0


@dataclass(frozen=True, slots=True)
class Advice:
    """One thing to do: ``code`` names it for programs, ``values`` are its numbers and names, ``text`` says it."""

    code: str
    text: str
    values: dict[str, float | list[str]] = field(default_factory=dict[str, float | list[str]])


@dataclass(frozen=True, slots=True)
class Stand:
    """How the board stands before the camera: its tilt, where its face is turned in the picture, its distance."""

    name: str
    tilt_deg: float
    towards: Literal["right", "left", "down", "up"]
    distance_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What views show so far, and what is to be done; no advice means that they are good to calibrate with.

    ``turned_deg`` and ``axis_spread`` are of the robot's poses as `Diversity` has them; None without two poses.
    """

    stands: tuple[Stand, ...]
    coverage: Coverage | None
    turned_deg: float | None
    axis_spread: float | None
    advice: tuple[Advice, ...]


def survey(
    kind: Kind,
    detections: Sequence[Detection],
    poses: Sequence[RobotPose | None],
    lens: Lens | None = None,
) -> Survey:
    """Return what the views show, and what is missing yet; ``poses`` are those of the robot, one for each view."""
    advice: list[Advice] = []
    missing = ENOUGH[kind] - len(detections)
    if missing > 0:
        advice.append(
            Advice(
                "views",
                f"{len(detections)} views: take {missing} more, {ENOUGH[kind]} are good",
                {"count": len(detections), "more": missing, "good": ENOUGH[kind]},
            )
        )
    if not detections:
        return Survey((), None, None, None, tuple(advice))
    known = lens or _guess(detections)
    turns = [_board_turn(view, known) for view in detections]
    stands = tuple(_stand(view, turn, away) for view, (turn, away) in zip(detections, turns, strict=True))
    coverage = measure_coverage(detections)
    turned_deg = axis_spread = None
    match kind:
        case "camera":
            advice += _of_places(coverage, thirds=True) + _of_tilts(stands)
        case "plane":
            advice += _of_places(coverage, thirds=False) + _of_flatness(detections, [turn for turn, _ in turns])
        case "hand-eye":
            given = [pose for pose in poses if pose is not None]
            without = [view.name for view, pose in zip(detections, poses, strict=True) if pose is None]
            if without:
                text = f"{', '.join(without)}: say where the robot was"
                advice.append(Advice("pose", text, {"views": without}))
            if len(given) > 1:
                turned_deg, axis_spread, found = _of_poses(given)
                advice += found
    return Survey(stands, coverage, turned_deg, axis_spread, tuple(advice))


def _guess(detections: Sequence[Detection]) -> Lens:
    """Return a lens without distortion, its focal length from the views where they tell one."""
    size = (detections[0].width, detections[0].height)
    focal = 1.2 * size[0]
    if len(detections) >= 3:
        points = [np.ascontiguousarray(d.points_mm.reshape(-1, 1, 3), np.float32) for d in detections]
        pixels = [np.ascontiguousarray(d.pixels.reshape(-1, 1, 2), np.float32) for d in detections]
        found = float(cv2.initCameraMatrix2D(points, pixels, size)[0, 0])
        focal = found if 0.3 * size[0] < found < 10.0 * size[0] else focal
    middle = ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    return Lens(np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]]), np.zeros(5))


def _board_turn(view: Detection, lens: Lens) -> tuple[Array, float]:
    pose = board_pose(view.points_mm, view.pixels, lens)
    turn, _ = cv2.Rodrigues(pose[:3])
    return np.asarray(turn, np.float64), float(np.linalg.norm(pose[3:]))


def _stand(view: Detection, turn: Array, distance_mm: float) -> Stand:
    x, y, z = (float(value) for value in turn[:, 2])
    tilt = float(np.rad2deg(np.arccos(np.clip(abs(z), 0.0, 1.0))))
    if abs(x) > abs(y):
        return Stand(view.name, tilt, "right" if x > 0 else "left", distance_mm)
    return Stand(view.name, tilt, "down" if y > 0 else "up", distance_mm)


def _of_places(coverage: Coverage, *, thirds: bool) -> list[Advice]:
    """Name the corners of the picture (thirds of its sides, or halves) in which no point was seen."""
    rows, columns = coverage.counts.shape
    height, width = (rows // 3, columns // 3) if thirds else (rows // 2, columns // 2)
    corners = {
        "upper left": coverage.counts[:height, :width],
        "upper right": coverage.counts[:height, columns - width :],
        "lower left": coverage.counts[rows - height :, :width],
        "lower right": coverage.counts[rows - height :, columns - width :],
    }
    empty = [name for name, counts in corners.items() if not counts.any()]
    if not empty:
        return []
    return [Advice("place", f"show the board near {', '.join(empty)} as well", {"places": [*empty]})]


def _of_tilts(stands: Sequence[Stand]) -> list[Advice]:
    found: list[Advice] = []
    tilted = [stand for stand in stands if stand.tilt_deg >= TILTED_DEG]
    if len(tilted) < TILTED_VIEWS:
        text = f"{len(tilted)} views are tilted: tilt the board by 20° to 45° in {TILTED_VIEWS - len(tilted)} more"
        found.append(Advice("tilt", text, {"count": len(tilted), "more": TILTED_VIEWS - len(tilted)}))
    seen = {stand.towards for stand in tilted}
    missing = [side for side in ("left", "right", "up", "down") if side not in seen]
    if tilted and missing:
        found.append(Advice("towards", f"turn the board's face {', '.join(missing)} as well", {"sides": [*missing]}))
    distances = [stand.distance_mm for stand in stands]
    if len(stands) > 1 and max(distances) < NEAR_AND_FAR * min(distances):
        found.append(Advice("distance", "hold the board nearer and farther as well"))
    return found


def _of_flatness(detections: Sequence[Detection], turns: Sequence[Array]) -> list[Advice]:
    """Name the boards that are not parallel to the others: on a table all are."""
    if len(turns) < 3:
        return []
    normals = np.array([turn[:, 2] for turn in turns])
    usual = np.median(normals, axis=0)
    apart = np.rad2deg(np.arccos(np.clip(normals @ (usual / np.linalg.norm(usual)), -1.0, 1.0)))
    odd = [view.name for view, lean in zip(detections, apart, strict=True) if lean > FLAT_DEG]
    text = f"{', '.join(odd)}: the board did not lie flat, take the picture again"
    return [Advice("flat", text, {"views": odd})] if odd else []


def _of_poses(poses: Sequence[RobotPose]) -> tuple[float, float, list[Advice]]:
    """Return the largest turn between two poses, the spread of the axes, and what to do about them."""
    hands = kuka_matrix(np.array([pose.frame for pose in poses]))
    first, second = np.triu_indices(len(hands), 1)
    turns = rotation_log(np.swapaxes(hands[first, :3, :3], 1, 2) @ hands[second, :3, :3])
    angles = np.rad2deg(np.linalg.norm(turns, axis=1))
    values = np.linalg.svd(turns, compute_uv=False)
    spread = float(values[1] / max(values[0], 1e-12)) if len(values) > 1 else 0.0
    largest = float(angles.max())
    found: list[Advice] = []
    if largest < TURNED_DEG:
        text = f"the poses differ by {largest:.0f}° at most: turn the flange by ±30° in different directions"
        found.append(Advice("turn", text, {"largest_deg": largest}))
    if len(poses) > 2 and spread < AXIS_SPREAD:
        text = "the flange turns about nearly one axis only: tilt it about a second one"
        found.append(Advice("axis", text, {"axis_spread": spread}))
    apart = np.linalg.norm(hands[first, :3, 3] - hands[second, :3, 3], axis=1)
    twins = [
        f"{poses[i].image} = {poses[j].image}"
        for i, j, turn, mm in zip(first.tolist(), second.tolist(), angles, apart, strict=True)
        if turn < TWIN_DEG and mm < TWIN_MM
    ]
    if twins:
        found.append(Advice("twins", f"{', '.join(twins)}: nearly the same pose tells nothing new", {"views": twins}))
    return largest, spread, found
