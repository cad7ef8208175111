"""How well are slabs laid, and does it drift?  Control charts, histograms and capability of the last measurements."""

from __future__ import annotations

import csv
import io
from typing import Any, Final

from starlette.responses import Response

from slabcell.hmi.cell_api import Json
from slabcell.hmi.route import get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.statistics import chart, statistics
from slabcell.hmi.visit import Visit

__all__ = ["ROUTES"]

LAST: Final = 500
EXPORTED: Final = 5000
KINDS: Final = {"dx_mm": ("mm", "tolerance_mm"), "dy_mm": ("mm", "tolerance_mm"), "da_deg": ("°", "tolerance_deg")}
COLUMNS: Final = ("at", "job", "slot", "found", "dx_mm", "dy_mm", "da_deg", "residual_mm")


async def _measurements(visit: Visit, most: int) -> Json:
    query: dict[str, Any] = {"limit": most}
    for name in ("job", "slot"):
        number = visit.number(name)
        if number is not None:
            query[name] = number
    return await visit.hmi.api.get("/v1/placements", **query)


async def _page(visit: Visit) -> Response:
    found = await _measurements(visit, LAST)
    rows = list(reversed(found["measurements"]))
    charts: list[dict[str, Any]] = []
    for kind, (unit, limit) in KINDS.items():
        values = [row[kind] for row in rows if row["found"] and row[kind] is not None]
        tolerance = float(found[limit])
        known = statistics(values, tolerance)
        drawn = chart(values, known, tolerance) if known else None
        charts.append({"kind": kind, "unit": unit, "tolerance": tolerance, "of": known, "drawn": drawn})
    return visit.page(
        "placements.html",
        charts=charts,
        count=len(rows),
        missing=sum(not row["found"] for row in rows),
        job=visit.text("job"),
        slot=visit.text("slot"),
        tab="placements",
    )


async def _export(visit: Visit) -> Response:
    found = await _measurements(visit, EXPORTED)
    out = io.StringIO()
    table = csv.writer(out)
    table.writerow(COLUMNS)
    for row in reversed(found["measurements"]):
        table.writerow([row[name] for name in COLUMNS])
    headers = {"content-disposition": 'attachment; filename="placements.csv"'}
    return Response(out.getvalue(), media_type="text/csv", headers=headers)


ROUTES = (
    get("/history/placements", _page, Role.VIEWER),
    get("/history/placements.csv", _export, Role.VIEWER),
)
