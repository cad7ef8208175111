"""With which calibration does the cell look?"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from slabcell.calibration.file import to_document
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Call, Endpoint

__all__ = ["ENDPOINTS"]


class CalibrationDocument(Document):
    """The calibration that the cell works with."""

    schema_: Literal["slabcell.cell-calibration/1"] = Field(default="slabcell.cell-calibration/1", alias="schema")
    calibration: dict[str, Any] = Field(description="a slabcell.calibration/1 object")


async def _active(call: Call[ApiContext]) -> CalibrationDocument:
    return CalibrationDocument(calibration=dict(to_document(call.context.cell.calibration)))


ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/calibration", "The calibration that is in use", _active, CalibrationDocument),
        "calibration",
    ),
)
