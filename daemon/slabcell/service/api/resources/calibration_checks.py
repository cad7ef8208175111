"""Does the calibration still hold, and how did that change over time?"""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from slabcell.calibration import Board
from slabcell.calibration.file import to_document
from slabcell.cell.preparing import require_calibration
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.resources.calibration import DETECTION_TIMEOUT_S, BoardBody, board_in, shelf_of
from slabcell.service.bench.wire import Json

__all__ = ["ENDPOINTS"]


class CheckBody(BoardBody):
    """A board that lies on the table."""

    board_thickness_mm: Annotated[float, Field(ge=0, le=200)] = Field(
        default=0.0, description="height of the printed face above the table"
    )
    limit_mm: Annotated[float, Field(ge=0.001, le=100)] = Field(
        default=0.2, description="drift above which the calibration no longer holds"
    )
    fixed: bool = Field(
        default=False,
        description="the board is always in the same place: held against the first such check of this calibration",
    )


class CheckDocument(Document):
    """Whether the calibration still holds, by one board; every check is kept."""

    schema_: Literal["slabcell.calibrate-check/1"] = Field(default="slabcell.calibrate-check/1", alias="schema")
    check: int = Field(description="its number")
    at: str
    calibration: str = Field(description="which one was checked")
    board_name: str
    picture: str
    ok: bool
    board: dict[str, Any] = Field(description="residuals, lift and tilt of the board, its scale")
    drift: dict[str, Any] | None = Field(description="of a fixed board since the first check: x, y, turn, worst point")
    limit_mm: float
    fixed: bool
    problems: list[str]


class ChecksQuery(Query):
    """Which checks."""

    limit: Annotated[int, Field(ge=1, le=2000)] = Field(default=200, description="so many, the newest of them")
    calibration: str = Field(default="", max_length=200, description="of this one only; none: of all")


class ChecksDocument(Document):
    """Checks that are kept, the oldest first."""

    schema_: Literal["slabcell.calibration-checks/1"] = Field(default="slabcell.calibration-checks/1", alias="schema")
    checks: list[CheckDocument]


async def _check(call: Call[ApiContext]) -> CheckDocument:
    context, said = call.context, call.body
    assert isinstance(said, CheckBody)  # noqa: S101 - as the endpoint declares
    shelf, calibration = shelf_of(context), require_calibration(context.cell.calibration)
    board = str(Board.parse(said.board))
    picture, seen = await board_in(context, said)
    found: Json | None = seen["found"]
    if found is None:
        raise ProblemError(422, str(seen["problem"]))
    name, kept = await asyncio.to_thread(lambda: (shelf.chosen, shelf.checks.read()))
    reference = _reference(kept, name, board) if said.fixed else None
    arguments = {
        "board": board,
        "detection": found,
        "reference": reference,
        "calibration": to_document(calibration),
        "board_thickness_mm": said.board_thickness_mm,
        "limit_mm": said.limit_mm,
    }
    done = (await context.studio.bench.run("check", arguments, timeout_s=DETECTION_TIMEOUT_S)).content
    problems = [str(problem) for problem in done["board"]["problems"]]
    drift: Json | None = done["drift"]
    if drift is not None and drift["worst_mm"] > said.limit_mm:
        problems.append(
            f"{picture}: the fixed board moved by {drift['worst_mm']:.2f} mm at most ({drift['x_mm']:+.2f},"
            f" {drift['y_mm']:+.2f} mm, {drift['turn_deg']:+.3f}°), the limit is {said.limit_mm:g} mm: the camera was"
            " moved; calibrate the plane again"
        )
    entry: Json = {
        "at": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "calibration": name,
        "board_name": board,
        "picture": picture,
        "ok": not problems,
        "board": done["board"],
        "drift": drift,
        "limit_mm": said.limit_mm,
        "fixed": said.fixed,
        "problems": problems,
    }
    first = said.fixed and reference is None
    empty: list[Any] = []
    points: Json = {"detection": {**found, "variants": empty}} if first else {}
    number = await asyncio.to_thread(shelf.checks.add, {**entry, **points})
    return CheckDocument.model_validate({"check": number, **entry})


def _reference(kept: list[Json], calibration: str, board: str) -> Json | None:
    """Return the board's points in the first check of a fixed board with this calibration; None if there is none."""
    for check in kept:
        if (check.get("calibration"), check.get("board_name")) == (calibration, board) and "detection" in check:
            return check["detection"]
    return None


async def _checks(call: Call[ApiContext]) -> ChecksDocument:
    query = call.query
    assert isinstance(query, ChecksQuery)  # noqa: S101 - as the endpoint declares
    kept = await asyncio.to_thread(shelf_of(call.context).checks.read)
    wanted = [item for item in kept if not query.calibration or item.get("calibration") == query.calibration]
    fields: Final = set(CheckDocument.model_fields) - {"schema_"}
    rows = [{key: value for key, value in item.items() if key in fields} for item in wanted[-query.limit :]]
    return ChecksDocument(checks=[CheckDocument.model_validate(row) for row in rows])


_TAG = "calibration"
ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/calibration/check", "Say whether the calibration still holds, by a board on the table", _check),
        *(CheckDocument, _TAG),
        body=CheckBody,
        problems=(404, 503),
    ),
    Endpoint(
        *("GET", "/v1/calibration/checks", "What checks found over time", _checks, ChecksDocument, _TAG),
        query=ChecksQuery,
        problems=(404,),
    ),
)
