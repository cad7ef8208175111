"""What is done by hand in a simulated cell?  Its calibration board is shown to the camera."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Body, Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.simulated_board import BoardPlace, BoardStand, ShownBoard
from slabcell.service.views import Pose

__all__ = ["ENDPOINTS"]


class ShowBody(Body):
    """Where the board is to be."""

    place: BoardPlace = Field(description="held before the camera, on the table, on the robot's flange, or away")
    number: Annotated[int, Field(ge=0, le=10_000)] = Field(default=0, description="which pose of many, from 0")


class BoardDocument(Document):
    """The board of the simulated cell."""

    schema_: Literal["slabcell.simulated-board/1"] = Field(default="slabcell.simulated-board/1", alias="schema")
    board: str = Field(description="as it is written for a calibration")
    thickness_mm: float
    place: BoardPlace
    number: int
    flange: Pose | None = Field(description="where the flange is that holds it: X Y Z A B C in the robot's base")


def _stand(context: ApiContext) -> BoardStand:
    if context.board is None:
        raise ProblemError(404, "this cell is not simulated: show the board to its camera by hand")
    return context.board


async def _board(call: Call[ApiContext]) -> BoardDocument:
    return _view(_stand(call.context).shown)


async def _show(call: Call[ApiContext]) -> BoardDocument:
    stand, said = _stand(call.context), call.body
    assert isinstance(said, ShowBody)  # noqa: S101 - as the endpoint declares
    return _view(await asyncio.to_thread(stand.show, said.place, said.number))


def _view(shown: ShownBoard) -> BoardDocument:
    return BoardDocument.model_validate(
        {name: getattr(shown, name) for name in ("board", "thickness_mm", "place", "number", "flange")}
    )


_TAG = "simulation"
ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/simulation/board", "Where the board of a simulated cell is", _board, BoardDocument, _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/simulation/board", "Show the board to a simulated camera, or take it away", _show),
        *(BoardDocument, _TAG),
        body=ShowBody,
        problems=(404,),
    ),
)
