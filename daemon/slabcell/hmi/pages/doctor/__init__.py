"""What is wrong with this cell, and what is there to do?  The findings of `slabcell doctor`."""

from __future__ import annotations

from starlette.responses import Response

from slabcell.hmi.route import Page, get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["PAGE"]

ORDER = ("error", "warning", "note", "ok")


async def _page(visit: Visit) -> Response:
    return visit.page("doctor.html")


async def _findings(visit: Visit) -> Response:
    found = await visit.hmi.api.get("/v1/doctor")
    findings = sorted(found["findings"], key=lambda item: (ORDER.index(item["severity"]), item["number"]))
    return visit.fragment("findings.html", findings=findings, counts=found["counts"], config=found["config"])


PAGE = Page(
    "doctor",
    "/doctor",
    Role.VIEWER,
    80,
    (get("/doctor", _page, Role.VIEWER), get("/doctor/findings", _findings, Role.ENGINEER)),
)
