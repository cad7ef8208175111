"""How is a camera calibrated on the running cell?  Find the board, collect views, compute in the background."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import asdict
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from slabcell.calibration import Board, HandEyeMethod, LensModel, Mount, calibration_from_document
from slabcell.calibration.advice import survey
from slabcell.calibration.file import to_document
from slabcell.calibration.handeye.stations import parse_poses
from slabcell.cell.preparing import require_calibration
from slabcell.errors import CalibrationError
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Body, Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.resources.calibration import (
    DETECTION_TIMEOUT_S,
    BoardBody,
    board_in,
    calibration_named,
    camera_identity,
    shelf_of,
)
from slabcell.service.api.resources.robot_pose import Coordinate, PoseBody, SaidPose, pose_said
from slabcell.service.api.resources.tasks import TaskDocument, task_view
from slabcell.service.bench.wire import Json
from slabcell.service.views import MAX_VIEWS, Pose, View

__all__ = ["ENDPOINTS"]

CALIBRATION_TIMEOUT_S: Final = 1800.0
POSES_BYTES: Final = 64 << 10


class ViewBody(BoardBody):
    """A picture of the board to calibrate with."""

    pose: SaidPose = Field(
        default=None,
        description="flange in the robot's base, X Y Z A B C, for a hand-eye calibration; robot: where it says it is",
    )


class PlaceBody(Body):
    """Where the robot was for a view."""

    pose: SaidPose = Field(description="X Y Z A B C; robot: where it says it is; null: unknown")


class SurveyQuery(Query):
    """For which calibration."""

    kind: Literal["camera", "plane", "hand-eye"] = "camera"


class TouchBody(Body):
    """A point that the robot touched: x and y as it shows them, and what was touched."""

    x: Coordinate
    y: Coordinate
    view: int | None = Field(default=None, description="number of the view whose board's point it is; none: the first")
    column: Annotated[int, Field(ge=0, le=200)] | None = Field(default=None, description="of the board's point, from 0")
    row: Annotated[int, Field(ge=0, le=200)] | None = Field(default=None, description="of the board's point, from 0")
    u: Coordinate | None = Field(default=None, description="or the pixel of a mark on the table")
    v: Coordinate | None = Field(default=None, description="or the pixel of a mark on the table")


class RunBody(Body):
    """What is to be computed, from which views."""

    kind: Literal["camera", "plane", "hand-eye"]
    views: Annotated[list[int], Field(max_length=MAX_VIEWS)] | None = Field(
        default=None, description="numbers of views; none: all"
    )
    calibration: Annotated[str, Field(max_length=200)] | None = Field(
        default=None, description="plane and hand-eye: what to go on from; none: the calibration in use"
    )
    model: LensModel = Field(default="brown5", description="camera: the lens model")
    board_thickness_mm: Annotated[float, Field(ge=0, le=200)] = Field(
        default=0.0, description="plane: height of the printed face above the table"
    )
    touch: Annotated[list[TouchBody], Field(max_length=200)] = Field(
        default_factory=list[TouchBody], description="plane: points that the robot touched"
    )
    affine: bool | None = Field(
        default=None, description="plane: whether touched points may scale and skew; none: decided by hold-out"
    )
    mount: Mount = Field(default="eye-to-hand", description="hand-eye")
    method: HandEyeMethod = Field(default="joint", description="hand-eye: how it is solved")
    robot_mm: Annotated[float, Field(ge=1e-4, le=100)] | None = Field(
        default=None, description="hand-eye: standard deviation of a robot pose; none: estimated"
    )
    robot_deg: Annotated[float, Field(ge=1e-5, le=45)] | None = Field(
        default=None, description="hand-eye: standard deviation of a robot pose; none: estimated"
    )
    photo_pose: PoseBody | None = Field(
        default=None, description="eye-in-hand: the flange when the table was calibrated"
    )


class DetectionDocument(Document):
    """Where the board's points are in a picture."""

    schema_: Literal["slabcell.board/1"] = Field(default="slabcell.board/1", alias="schema")
    picture: str
    width: int
    height: int
    columns: int = Field(description="points in a row of the board")
    rows: int = Field(description="points in a column of the board")
    found: bool
    points: list[list[float]] = Field(description="number on the board, row by row from 0, then u and v in pixels")
    note: str = Field(description="what is to be said of it")
    problem: str = Field(description="why it was not found; empty if it was")


class ViewDocument(Document):
    """One view."""

    view: int
    picture: str
    board: str
    points: int
    hull: list[list[float]] = Field(description="the outermost points, u and v, to draw where the board was")
    pose: Pose | None


class ViewsDocument(Document):
    """What was collected, the oldest first."""

    schema_: Literal["slabcell.calibration-views/1"] = Field(default="slabcell.calibration-views/1", alias="schema")
    views: list[ViewDocument]


class AdviceDocument(Document):
    """One thing to do."""

    code: str = Field(description="views, place, tilt, towards, distance, flat, pose, turn, axis or twins")
    text: str
    values: dict[str, Any]


class StandDocument(Document):
    """How the board stood before the camera."""

    name: str
    tilt_deg: float
    towards: str = Field(description="where its face is turned in the picture: right, left, down or up")
    distance_mm: float


class SurveyDocument(Document):
    """What the views show so far, and what is missing yet."""

    schema_: Literal["slabcell.calibration-survey/1"] = Field(default="slabcell.calibration-survey/1", alias="schema")
    kind: str
    stands: list[StandDocument]
    coverage: dict[str, Any] | None = Field(
        description="width, height, parts covered, and counts: points in each cell of a grid over the picture"
    )
    turned_deg: float | None = Field(description="largest turn between two poses of the robot")
    axis_spread: float | None = Field(description="0 if all turns share one axis, 1 if none is preferred")
    advice: list[AdviceDocument] = Field(description="empty if the views are good to calibrate with")


async def _detect(call: Call[ApiContext]) -> DetectionDocument:
    name, seen = await board_in(call.context, call.body)
    found: Json | None = seen["found"]
    columns, rows = seen["grid"]
    points: list[list[float]] = []
    if found is not None:
        pixels: list[tuple[float, float]] = found["pixels"]
        points = [
            [float(index), round(u, 3), round(v, 3)] for index, (u, v) in zip(found["indices"], pixels, strict=True)
        ]
    return DetectionDocument(
        picture=name,
        width=seen["width"],
        height=seen["height"],
        columns=columns,
        rows=rows,
        found=found is not None,
        points=points,
        note="" if found is None else found["note"],
        problem=seen["problem"],
    )


async def _add(call: Call[ApiContext]) -> ViewDocument:
    context, said = call.context, call.body
    assert isinstance(said, ViewBody)  # noqa: S101 - as the endpoint declares
    others = {view.board for view in context.studio.views.all} - {said.board}
    if others:
        raise ProblemError(409, f"the views so far are of {', '.join(others)}: use one board, or clear them first")
    name, seen = await board_in(context, said)
    if seen["found"] is None:
        raise ProblemError(422, str(seen["problem"]))
    return _view(context.studio.views.add(name, said.board, seen["found"], pose_said(context, said.pose)))


async def _place(call: Call[ApiContext]) -> ViewDocument:
    context, said, number = call.context, call.body, call.number("view")
    assert isinstance(said, PlaceBody)  # noqa: S101 - as the endpoint declares
    if context.studio.views.get(number) is None:
        raise ProblemError(404, f"there is no view {number}")
    return _view(context.studio.views.place(number, pose_said(context, said.pose)))


async def _poses(call: Call[ApiContext]) -> ViewsDocument:
    """Take the poses of a table; all of it, or nothing."""
    kept = call.context.studio.views
    named = {name: view.number for view in kept.all for name in (str(view.number), view.name, view.picture)}
    try:
        poses = parse_poses(call.raw, "the table")
    except CalibrationError as error:
        raise ProblemError(422, str(error)) from error
    unknown = [pose.image for pose in poses if pose.image not in named]
    if unknown:
        raise ProblemError(422, f"the table names {', '.join(unknown)[:200]}, which is no view: write 1, 2, ...")
    for pose in poses:
        kept.place(named[pose.image], pose.frame)
    return ViewsDocument(views=[_view(view) for view in kept.all])


async def _survey(call: Call[ApiContext]) -> SurveyDocument:
    context, query = call.context, call.query
    assert isinstance(query, SurveyQuery)  # noqa: S101 - as the endpoint declares
    views, present = context.studio.views.all, context.cell.calibration
    if not views:  # there is nothing to compute
        return SurveyDocument.model_validate({"kind": query.kind, **asdict(survey(query.kind, (), ()))})
    fits = present is not None and all(
        (view.detection["width"], view.detection["height"]) == (present.camera.width, present.camera.height)
        for view in views
    )
    arguments: Json = {
        "kind": query.kind,
        "board": str(Board.parse(views[0].board)),
        "views": [{"name": view.name, "detection": view.detection, "pose": view.pose} for view in views],
        "calibration": to_document(present) if present is not None and fits else None,
    }
    done = await context.studio.bench.run("survey", arguments, timeout_s=DETECTION_TIMEOUT_S)
    return SurveyDocument.model_validate({"kind": query.kind, **done.content})


async def _list(call: Call[ApiContext]) -> ViewsDocument:
    return ViewsDocument(views=[_view(view) for view in call.context.studio.views.all])


def _view(view: View) -> ViewDocument:
    pixels = view.detection["pixels"]
    return ViewDocument(
        view=view.number,
        picture=view.picture,
        board=view.board,
        points=len(pixels),
        hull=_hull(pixels),
        pose=view.pose,
    )


def _hull(pixels: list[list[float]]) -> list[list[float]]:
    """Return the corners of the convex hull of points (Andrew's monotone chain), which are few hundreds at most."""

    def half(points: list[list[float]]) -> list[list[float]]:
        chain: list[list[float]] = []
        for u, v in points:
            while len(chain) > 1:
                (a, b), (c, d) = chain[-2:]
                if (c - a) * (v - b) - (d - b) * (u - a) > 0.0:
                    break
                chain.pop()
            chain.append([u, v])
        return chain[:-1]

    ordered = sorted(pixels)
    return [[round(u, 2), round(v, 2)] for u, v in [*half(ordered), *half(ordered[::-1])]]


async def _remove(call: Call[ApiContext]) -> Done:
    number = call.number("view")
    if call.context.studio.views.get(number) is None:
        raise ProblemError(404, f"there is no view {number}")
    call.context.studio.views.remove(number)
    return Done(detail=f"view {number} is forgotten")


async def _clear(call: Call[ApiContext]) -> Done:
    call.context.studio.views.clear()
    return Done(detail="every view is forgotten")


async def _run(call: Call[ApiContext]) -> TaskDocument:
    context, said = call.context, call.body
    assert isinstance(said, RunBody)  # noqa: S101 - as the endpoint declares
    shelf = shelf_of(context)
    views = _chosen(context, said)
    arguments: Json = {
        **said.model_dump(mode="json"),
        "board": str(Board.parse(views[0].board)),
        "touch": [{"number": number, **item.model_dump()} for number, item in enumerate(said.touch, start=1)],
        "views": [{"name": view.name, "detection": view.detection, "pose": view.pose} for view in views],
        **await _start(context, said, views),
    }

    async def work(progress: Callable[[Json], None]) -> Json:
        done = await context.studio.bench.run(
            "calibrate", arguments, timeout_s=CALIBRATION_TIMEOUT_S, progress=progress
        )
        found = calibration_from_document(done.content["calibration"], "the calibration")
        name = await asyncio.to_thread(shelf.save, found)
        report: dict[str, Any] = {**done.content["report"], "out": name}
        return {"schema": "slabcell.calibration-made/1", "calibration": name, "report": report}

    title = f"{said.kind} calibration from {len(views)} views"
    return task_view(context.studio.background.start(f"calibrate-{said.kind}", title, work))


def _chosen(context: ApiContext, said: RunBody) -> list[View]:
    kept = context.studio.views
    views = [kept.get(number) for number in said.views] if said.views is not None else list(kept.all)
    if None in views or not views:
        missing = "" if said.views is None else f" with the numbers {', '.join(map(str, said.views))}"
        raise ProblemError(422, f"there are no views{missing}: collect some first")
    found = [view for view in views if view is not None]
    if said.kind == "hand-eye" and any(view.pose is None for view in found):
        names = ", ".join(str(view.number) for view in found if view.pose is None)
        raise ProblemError(422, f"views {names} say no pose of the robot, which a hand-eye calibration needs")
    return found


async def _start(context: ApiContext, said: RunBody, views: list[View]) -> Json:
    """Return what it goes on from: for a lens the identity of the camera, for the rest a calibration.

    Raises CalibrationError for views of another size than the camera's, and ProblemError 404.
    """
    present = context.cell.calibration
    if said.kind != "camera":
        named = said.calibration
        base = require_calibration(present) if named is None else await calibration_named(context, named)
        return {"calibration": to_document(base)}
    identity = camera_identity(context) if present is None else present.camera
    for view in views:
        size = (view.detection["width"], view.detection["height"])
        if size != (identity.width, identity.height):
            raise CalibrationError(
                f"{view.name} has {size[0]}x{size[1]} pixels, the camera {identity.width}x{identity.height}:"
                " take the picture with the settings of the camera"
            )
    return {
        "calibration": None,
        "serial": identity.serial,
        "offset": [identity.offset_x, identity.offset_y],
        "binning": identity.binning,
    }


_TAG = "calibration"
ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/calibration/detect", "Find the board in a picture", _detect, DetectionDocument, _TAG),
        body=BoardBody,
        problems=(404, 503),
        kept=False,
    ),
    Endpoint("GET", "/v1/calibration/views", "The views that were collected", _list, ViewsDocument, _TAG),
    Endpoint(
        *("POST", "/v1/calibration/views", "Collect a view: the board's points in a picture", _add, ViewDocument, _TAG),
        body=ViewBody,
        problems=(404, 503),
    ),
    Endpoint(
        *("POST", "/v1/calibration/views/{view}/remove", "Forget a view", _remove, Done, _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/calibration/views/{view}/pose", "Say where the robot was for a view", _place),
        *(ViewDocument, _TAG),
        body=PlaceBody,
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/calibration/poses", "Say where the robot was, as a table: image,X,Y,Z,A,B,C", _poses),
        *(ViewsDocument, _TAG),
        raw="text/csv",
        body_bytes=POSES_BYTES,
    ),
    Endpoint(
        *("GET", "/v1/calibration/survey", "What the views cover, and what is missing yet", _survey),
        *(SurveyDocument, _TAG),
        query=SurveyQuery,
        problems=(503,),
    ),
    Endpoint("POST", "/v1/calibration/clear", "Forget every view", _clear, Done, _TAG),
    Endpoint(
        *("POST", "/v1/calibration/run", "Compute a calibration from the views, in the background", _run),
        *(TaskDocument, _TAG),
        body=RunBody,
        problems=(404, 503),
    ),
)
