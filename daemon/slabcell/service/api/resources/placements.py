"""How did laid slabs lie, job after job?  Every measurement of a verification, for statistics and control charts."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Call, Endpoint, Query

__all__ = ["ENDPOINTS"]

MAX_PAGE: Final = 5000
FIRST: Final = 1 << 60


class PlacementsQuery(Query):
    """Which measurements, and which page of them."""

    limit: Annotated[int, Field(ge=1, le=MAX_PAGE)] = Field(default=500, description="at most so many")
    before: Annotated[int, Field(ge=1)] = Field(default=FIRST, description="only measurements with an id below this")
    job: Annotated[int, Field(ge=0)] | None = Field(default=None, description="only of this job")
    slot: Annotated[int, Field(ge=0)] | None = Field(default=None, description="only of this slot")


class MeasurementDocument(Document):
    """One slab, measured once: placed minus nominal, in the assembly frame."""

    id: int
    job: int
    slot: int
    found: bool
    dx_mm: float | None
    dy_mm: float | None
    da_deg: float | None
    residual_mm: float | None
    at: str


class MeasurementsDocument(Document):
    """A page of measurements, the newest first, and the limits that they are held against."""

    schema_: Literal["slabcell.measurements/1"] = Field(default="slabcell.measurements/1", alias="schema")
    tolerance_mm: float
    tolerance_deg: float
    measurements: list[MeasurementDocument]
    before: int | None = Field(description="give this as before= for the next page; null if there is none")


async def _list(call: Call[ApiContext]) -> MeasurementsDocument:
    query: PlacementsQuery = call.query
    rows = await call.context.ledger.measurements(
        before=query.before, limit=query.limit + 1, job=query.job, slot=query.slot
    )
    shown = rows[: query.limit]
    settings = call.context.cell.settings
    return MeasurementsDocument(
        tolerance_mm=settings.tolerance_mm,
        tolerance_deg=settings.tolerance_deg,
        measurements=[
            MeasurementDocument(
                id=row.id,
                job=row.job_id,
                slot=row.slot,
                found=row.found,
                dx_mm=row.dx_mm,
                dy_mm=row.dy_mm,
                da_deg=row.da_deg,
                residual_mm=row.residual_mm,
                at=row.at_utc,
            )
            for row in shown
        ],
        before=shown[-1].id if len(rows) > query.limit else None,
    )


ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/placements", "How slabs were measured to lie, the newest first", _list, MeasurementsDocument),
        "jobs",
        query=PlacementsQuery,
        problems=(409,),
    ),
)
