"""Where is the board, and what calibration do these views give?  On the bench."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, cast

import numpy as np

from slabcell.calibration import (
    Board,
    Detection,
    HandEyeMethod,
    LensModel,
    Mount,
    RobotPose,
    Touch,
    calibrate_camera,
    calibrate_hand_eye,
    calibrate_plane,
    calibration_from_document,
    calibration_to_document,
    check_board,
    detect_board,
    drift_of_board,
)
from slabcell.calibration.advice import Kind, survey
from slabcell.calibration.report import camera_document, hand_eye_document, plane_document
from slabcell.errors import ImageError
from slabcell.service.bench.wire import Json, Message
from slabcell.service.bench.work import Work

__all__ = ["calibrate", "check", "detect", "look_over"]


def detect(work: Work) -> Message:
    """Return where the board's points are in the picture, or why it was not found."""
    board = Board.parse(work.arguments["board"])
    picture = work.picture()
    height, width = picture.shape[:2]
    try:
        found = detect_board(picture, board, work.arguments["name"])
    except ImageError as error:
        return Message({"found": None, "problem": str(error), "width": width, "height": height, "grid": [*board.grid]})
    return Message(
        {"found": _to_document(found), "problem": "", "width": width, "height": height, "grid": [*board.grid]}
    )


def check(work: Work) -> Message:
    """Return whether a calibration still holds, by a board that was detected."""
    said = work.arguments
    board = Board.parse(said["board"])
    calibration = calibration_from_document(said["calibration"], "the calibration")
    now = _from_document(said["detection"], board, "the picture")
    thickness_mm = said["board_thickness_mm"]
    done = check_board(calibration, now, board, board_thickness_mm=thickness_mm, limit_mm=said["limit_mm"])
    drift: Json | None = None
    if said["reference"] is not None:
        before = _from_document(said["reference"], board, "the first picture")
        drift = drift_of_board(calibration, before, now, board_thickness_mm=thickness_mm).to_document()
    return Message({"board": done.to_document(), "drift": drift})


def look_over(work: Work) -> Message:
    """Return what collected views show so far, and what is missing yet for a calibration of one kind."""
    said = work.arguments
    board = Board.parse(said["board"]) if said["views"] else None
    views = [_from_document(view["detection"], board, view["name"]) for view in said["views"] if board is not None]
    poses = [None if view["pose"] is None else _pose(view["name"], view["pose"]) for view in said["views"]]
    base = said["calibration"]
    lens = None if base is None else calibration_from_document(base, "the calibration").lens
    found = survey(cast("Kind", said["kind"]), views, poses, lens)
    return Message(
        {
            "stands": [asdict(stand) for stand in found.stands],
            "coverage": None if found.coverage is None else found.coverage.to_document(),
            "turned_deg": found.turned_deg,
            "axis_spread": found.axis_spread,
            "advice": [asdict(item) for item in found.advice],
        }
    )


def calibrate(work: Work) -> Message:
    """Return a calibration of one kind from views, and what to think of it."""
    said = work.arguments
    board = Board.parse(said["board"])
    views = [_from_document(view["detection"], board, view["name"]) for view in said["views"]]
    work.progress({"done": 0, "total": 1, "doing": f"{said['kind']} from {len(views)} views"})
    match said["kind"]:
        case "camera":
            offset = said["offset"]
            camera = calibrate_camera(
                views,
                board,
                model=cast("LensModel", said["model"]),
                serial=said["serial"],
                offset=(offset[0], offset[1]),
                binning=said["binning"],
            )
            report, done = camera_document(camera, "", ()), camera.calibration
        case "plane":
            plane = calibrate_plane(
                calibration_from_document(said["calibration"], "the calibration"),
                views,
                board,
                board_thickness_mm=said["board_thickness_mm"],
                touch=[_touch(item) for item in said["touch"]],
                affine=said["affine"],
            )
            report, done = plane_document(plane, "", ()), plane.calibration
        case _:
            stand = said["photo_pose"]
            hand_eye = calibrate_hand_eye(
                calibration_from_document(said["calibration"], "the calibration"),
                views,
                [_pose(view["name"], view["pose"]) for view in said["views"]],
                board,
                cast("Mount", said["mount"]),
                method=cast("HandEyeMethod", said["method"]),
                robot_mm=said["robot_mm"],
                robot_deg=said["robot_deg"],
                photo_pose=None if stand is None else _pose("photo", stand),
            )
            report, done = hand_eye_document(hand_eye, "", ()), hand_eye.calibration
    return Message({"report": report, "calibration": calibration_to_document(done)})


def _pose(name: str, frame: Any) -> RobotPose:
    x, y, z, a, b, c = (float(value) for value in frame)
    return RobotPose(name, (x, y, z, a, b, c))


def _touch(item: Json) -> Touch:
    corner = (int(item["column"] or 0), int(item["row"] or 0))
    pixel = None if item["u"] is None or item["v"] is None else (float(item["u"]), float(item["v"]))
    image = "" if item["view"] is None else f"view-{item['view']}"
    return Touch(f"touched point {item['number']}", float(item["x"]), float(item["y"]), image, corner, pixel)


def _to_document(found: Detection) -> Json:
    return {
        "width": found.width,
        "height": found.height,
        "indices": found.indices.tolist(),
        "pixels": found.pixels.tolist(),
        "variants": [[window, pixels.tolist()] for window, pixels in found.variants],
        "note": found.note,
    }


def _from_document(said: Json, board: Board, name: str) -> Detection:
    indices = np.array(said["indices"], np.int64)
    return Detection(
        name,
        int(said["width"]),
        int(said["height"]),
        indices,
        board.points[indices],
        np.array(said["pixels"], np.float64).reshape(-1, 2),
        tuple((int(window), np.array(pixels, np.float64).reshape(-1, 2)) for window, pixels in said["variants"]),
        str(said["note"]),
        board.diameter_mm,
    )
