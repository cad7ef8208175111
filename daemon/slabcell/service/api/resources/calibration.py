"""With which calibration does the cell look, which others are there, and does it still hold?"""

from __future__ import annotations

import asyncio
import json
from math import isfinite
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from slabcell.calibration import Calibration, CameraIdentity, calibration_from_document, load_calibration
from slabcell.calibration.compare import displacements, distance
from slabcell.calibration.file import MAX_BYTES, to_document
from slabcell.catalogue import Fault
from slabcell.cell.preparing import NO_CALIBRATION
from slabcell.errors import CalibrationError
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Body, Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.resources.calibration_figures import FiguresDocument, figures_of
from slabcell.service.api.resources.vision import chosen_picture
from slabcell.service.bench.wire import Json
from slabcell.service.calibrations import CalibrationEntry, CalibrationShelf

__all__ = [
    "DETECTION_TIMEOUT_S",
    "ENDPOINTS",
    "BoardBody",
    "board_in",
    "calibration_named",
    "camera_identity",
    "shelf_of",
]

DETECTION_TIMEOUT_S: Final = 30.0
BoardText = Annotated[str, Field(max_length=200, description="as on the command line, e.g. checkerboard:12x9:25")]


class BoardBody(Body):
    """Which board, and in which picture."""

    board: BoardText
    picture: Annotated[str, Field(max_length=80)] = Field(
        default="latest", description="latest, cycle:NUMBER, or upload:ID of an uploaded picture"
    )


class CalibrationDocument(Document):
    """The calibration that the cell works with."""

    schema_: Literal["slabcell.cell-calibration/1"] = Field(default="slabcell.cell-calibration/1", alias="schema")
    calibration: dict[str, Any] = Field(description="a slabcell.calibration/1 object")


class DriftDocument(Document):
    """How far two calibrations differ about where the same pixels lie on the table."""

    mean_mm: float
    worst_mm: float


class KeptCalibrationDocument(Document):
    """One calibration that is kept."""

    name: str = Field(description="configured, or the name that it was kept under")
    active: bool
    created: str
    sha256: str
    serial: str
    width: int
    height: int
    has_plane: bool
    has_hand_eye: bool
    rms_px: float | None
    drift: DriftDocument | None = Field(
        description="from this one to the active one; null where they cannot be compared"
    )
    figures: FiguresDocument | None = Field(description="what is known of how good it is; null if it cannot be read")
    problem: str = Field(description="what is wrong with its file; empty if nothing is")


class CalibrationsDocument(Document):
    """Every calibration of the cell, the newest first."""

    schema_: Literal["slabcell.calibrations/1"] = Field(default="slabcell.calibrations/1", alias="schema")
    calibrations: list[KeptCalibrationDocument]


class CompareQuery(Query):
    """With which one it is compared."""

    base: str = Field(default="", max_length=200, description="name of the one before; none: the one in use")


class ComparedDocument(Document):
    """Two calibrations of one camera, before and after."""

    schema_: Literal["slabcell.calibrations-compared/1"] = Field(
        default="slabcell.calibrations-compared/1", alias="schema"
    )
    before: str
    after: str
    width: int
    height: int
    figures_before: FiguresDocument
    figures_after: FiguresDocument
    drift: DriftDocument | None = Field(description="null where they cannot be compared")
    moved: list[list[float]] = Field(
        description="pixels all over the picture, and by how much their points on the table move: u, v, x mm, y mm"
    )


class UploadedDocument(Document):
    """A calibration that was kept."""

    schema_: Literal["slabcell.calibration-kept/1"] = Field(default="slabcell.calibration-kept/1", alias="schema")
    name: str = Field(description="what it is called; it is not active yet")


def shelf_of(context: ApiContext) -> CalibrationShelf:
    """Return where calibrations are kept.  Raises ProblemError 404."""
    if context.calibrations is None:
        raise ProblemError(404, "this daemon keeps no calibrations")
    return context.calibrations


async def calibration_named(context: ApiContext, name: str) -> Calibration:
    """Return a calibration that is kept.  Raises ProblemError 404, or CalibrationError for a damaged one."""
    shelf = shelf_of(context)
    try:
        path = await asyncio.to_thread(shelf.path_of, name)
    except CalibrationError as error:
        raise ProblemError(404, str(error), number=error.number) from error
    return await asyncio.to_thread(load_calibration, path)


def camera_identity(context: ApiContext) -> CameraIdentity:
    """Return which camera the cell has: as it says, else as the present calibration says.

    Raises ProblemError 503 where neither is known yet.
    """
    info, present = context.camera(), context.cell.calibration
    if info is not None:
        return CameraIdentity(info.width, info.height, info.serial)
    if present is None:
        raise ProblemError(503, "the camera has not been seen yet, and there is no calibration: connect the camera")
    return present.camera


async def board_in(context: ApiContext, said: BoardBody) -> tuple[str, Json]:
    """Return the picture's name, and what the bench says of the board in it."""
    picture = await chosen_picture(context, said.picture)
    arguments = {**picture.arguments, "name": picture.name, "board": said.board}
    done = await context.studio.bench.run("detect", arguments, (picture.blob,), timeout_s=DETECTION_TIMEOUT_S)
    return picture.name, done.content


async def _active(call: Call[ApiContext]) -> CalibrationDocument:
    found = call.context.cell.calibration
    if found is None:
        raise ProblemError(404, NO_CALIBRATION, number=Fault.CALIBRATION_MISSING)
    return CalibrationDocument(calibration=dict(to_document(found)))


async def _history(call: Call[ApiContext]) -> CalibrationsDocument:
    shelf, active = shelf_of(call.context), call.context.cell.calibration
    entries, chosen = await asyncio.to_thread(lambda: (shelf.entries(), shelf.chosen))
    return await asyncio.to_thread(
        lambda: CalibrationsDocument(
            calibrations=[_kept(entry, active, in_use=entry.name == chosen) for entry in entries]
        )
    )


def _kept(entry: CalibrationEntry, active: Calibration | None, *, in_use: bool) -> KeptCalibrationDocument:
    found = entry.calibration
    apart = None if found is None or active is None else distance(found, active)
    rms = None if found is None else found.diagnostics.get("rms_px")
    return KeptCalibrationDocument(
        name=entry.name,
        active=in_use,
        created=entry.created,
        sha256=entry.sha256,
        serial=found.camera.serial if found else "",
        width=found.camera.width if found else 0,
        height=found.camera.height if found else 0,
        has_plane=found is not None and found.plane is not None,
        has_hand_eye=found is not None and found.hand_eye is not None,
        rms_px=float(rms) if isinstance(rms, int | float) else None,
        drift=None if apart is None else DriftDocument(mean_mm=apart.mean_mm, worst_mm=apart.worst_mm),
        figures=None if found is None else figures_of(found),
        problem=entry.problem,
    )


async def _named(call: Call[ApiContext]) -> CalibrationDocument:
    found = await calibration_named(call.context, call.text("name"))
    return CalibrationDocument(calibration=dict(to_document(found)))


async def _compare(call: Call[ApiContext]) -> ComparedDocument:
    context = call.context
    assert isinstance(call.query, CompareQuery)  # noqa: S101 - as the endpoint declares
    name, base = call.text("name"), call.query.base or await asyncio.to_thread(lambda: shelf_of(context).chosen)
    after, before = await calibration_named(context, name), await calibration_named(context, base)
    moved, apart = await asyncio.to_thread(lambda: (displacements(before, after), distance(before, after)))
    rows = [] if moved is None else [row for row in moved.round(4).tolist() if all(map(isfinite, row))]
    return ComparedDocument(
        before=base,
        after=name,
        width=after.camera.width,
        height=after.camera.height,
        figures_before=figures_of(before),
        figures_after=figures_of(after),
        drift=None if apart is None else DriftDocument(mean_mm=apart.mean_mm, worst_mm=apart.worst_mm),
        moved=rows,
    )


async def _upload(call: Call[ApiContext]) -> UploadedDocument:
    context = call.context
    try:
        document: object = json.loads(call.raw)
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise ProblemError(422, f"the calibration is no JSON: {error}") from error
    try:
        found = calibration_from_document(document, "the calibration")
        _require_this_camera(context, found)
    except CalibrationError as error:
        raise ProblemError(422, str(error), number=error.number) from error
    return UploadedDocument(name=await asyncio.to_thread(shelf_of(context).save, found))


def _require_this_camera(context: ApiContext, calibration: Calibration) -> None:
    """Raise CalibrationError for a calibration of another camera than the one that is, or was last, connected."""
    identity = camera_identity(context)
    calibration.require_camera(identity, f"camera {identity.serial or 'of the present calibration'}")


async def _activate(call: Call[ApiContext]) -> Done:
    context, name = call.context, call.text("name")
    calibration = await calibration_named(context, name)
    try:
        calibration.require_plane()
        _require_this_camera(context, calibration)
    except CalibrationError as error:
        raise ProblemError(422, str(error), number=error.number) from error
    before = context.cell.calibration
    await context.cell.change(calibration=calibration)
    await asyncio.to_thread(shelf_of(context).choose, name)
    apart = None if before is None else await asyncio.to_thread(distance, before, calibration)
    moved = f"; points of the table moved by {apart.mean_mm:.3f} mm, {apart.worst_mm:.3f} at most" if apart else ""
    return Done(detail=f"calibration {name} is in use, for restarts too{moved}")


_TAG = "calibration"
ENDPOINTS = (
    Endpoint(
        "GET", "/v1/calibration", "The calibration that is in use", _active, CalibrationDocument, _TAG, problems=(404,)
    ),
    Endpoint(
        *(
            "GET",
            "/v1/calibrations",
            "Every calibration that is kept, and how far each is from the one in use",
            _history,
        ),
        *(CalibrationsDocument, _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("GET", "/v1/calibrations/{name}", "One of them, as its file is", _named, CalibrationDocument, _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("GET", "/v1/calibrations/{name}/compare", "Hold it against another: figures, and what moves", _compare),
        *(ComparedDocument, _TAG),
        query=CompareQuery,
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/calibrations", "Upload a calibration of this camera; it is not active yet", _upload),
        *(UploadedDocument, _TAG),
        raw="application/json",
        body_bytes=MAX_BYTES,
    ),
    Endpoint(
        *("POST", "/v1/calibrations/{name}/activate", "Work with another calibration; between jobs only", _activate),
        *(Done, _TAG),
        problems=(404,),
    ),
)
