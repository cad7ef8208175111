"""Which jobs were there, and what became of each slab?"""

from __future__ import annotations

import csv
import io
from typing import Any, Final

from starlette.responses import Response

from slabcell.hmi.route import get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["ROUTES"]

ROWS: Final = 30


async def _page(visit: Visit) -> Response:
    query: dict[str, Any] = {"limit": ROWS}
    before = visit.number("before")
    if before is not None:
        query["before"] = before
    state = visit.text("state")
    if state:
        query["state"] = state
    found = await visit.hmi.api.get("/v1/jobs", **query)
    ledger = None
    wanted = visit.number("job") or (found["jobs"][0]["job"] if found["jobs"] else None)
    if wanted is not None:
        ledger = await visit.hmi.api.get(f"/v1/jobs/{wanted}")
    return visit.page("jobs.html", jobs=found["jobs"], before=found["before"], state=state, ledger=ledger, tab="jobs")


async def _export(visit: Visit) -> Response:
    number = visit.number("job")
    ledger = await visit.hmi.api.get(f"/v1/jobs/{number}")
    out = io.StringIO()
    table = csv.writer(out)
    table.writerow(["job", "result", "slot", "state", "score", "reason", "changed"])
    for offer in ledger["offers"]:
        table.writerow([number, *(offer[name] for name in ("result", "slot", "state", "score", "reason", "changed"))])
    headers = {"content-disposition": f'attachment; filename="job-{number}.csv"'}
    return Response(out.getvalue(), media_type="text/csv", headers=headers)


ROUTES = (
    get("/history/jobs", _page, Role.VIEWER),
    get("/history/jobs/{job}.csv", _export, Role.VIEWER),
)
