"""Start, stop, step; what is offered to the robot and acknowledged by it; what a person has to say of a slab."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any, Final

from starlette.responses import Response

from slabcell.errors import SlabcellError
from slabcell.hmi.route import Page, get, post
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Refusal, Visit

__all__ = ["PAGE"]

CONTROLS: Final = {
    "start": ("halted",),
    "stop": (
        *("initialized", "ready", "single_execution"),
        *(f"single_execution.{leaf}" for leaf in ("acquiring", "locating", "offering", "verifying")),
    ),
    "step": ("halted", "ready", "single_execution.offering"),
    "clear": ("error",),
}
"""In which states each control does something; elsewhere its button is off."""


async def _values(visit: Visit) -> dict[str, Any]:
    hmi = visit.hmi
    values: dict[str, Any] = {"drawing": None, "ledger": None, "controls": {}}
    status = hmi.link.status
    if status is None:
        return values
    values["controls"] = {name: status["state"] in states for name, states in CONTROLS.items()}
    try:
        values["drawing"] = await hmi.template.drawing(status, visit.words("drawing"))
        if status["job"] is not None:
            values["ledger"] = await hmi.api.get("/v1/jobs/current")
    except SlabcellError:
        if hmi.link.up:
            raise
    return values


async def _page(visit: Visit) -> Response:
    return visit.page("run.html", **await _values(visit))


async def _work(visit: Visit) -> Response:
    return visit.fragment("work.html", **await _values(visit))


async def _buttons(visit: Visit) -> Response:
    return visit.fragment("buttons.html", **await _values(visit))


async def _start(visit: Visit) -> Response:
    return await visit.post("/v1/start")


async def _stop(visit: Visit) -> Response:
    return await visit.post("/v1/stop")


async def _step(visit: Visit) -> Response:
    return await visit.post("/v1/step")


async def _clear(visit: Visit) -> Response:
    return await visit.post("/v1/clear")


async def _look(visit: Visit) -> Response:
    done = await visit.hmi.api.post("/v1/trigger", user=visit.user.name, key=visit.key())
    return visit.done(visit.words("looked", found=done["found"], rejected=done["rejected"]))


async def _verify(visit: Visit) -> Response:
    done = await visit.hmi.api.post("/v1/verify", user=visit.user.name, key=visit.key())
    found = sum(bool(item["found"]) for item in done["placements"])
    return visit.done(visit.words("verified", found=found, all=len(done["placements"])))


async def _abandon(visit: Visit) -> Response:
    return await visit.post("/v1/jobs/current/abandon")


async def _resolve(visit: Visit) -> Response:
    verdict, result = visit.text("verdict"), visit.number("result")
    if verdict not in {"placed", "failed"} or result is None:
        raise Refusal(HTTPStatus.UNPROCESSABLE_ENTITY, "refused.no")
    return await visit.post(f"/v1/ledger/{result}/resolve", {"verdict": verdict})


PAGE = Page(
    "run",
    "/run",
    Role.VIEWER,
    20,
    (
        get("/run", _page, Role.VIEWER),
        get("/run/work", _work, Role.VIEWER),
        get("/run/buttons", _buttons, Role.VIEWER),
        post("/run/start", _start, Role.OPERATOR),
        post("/run/stop", _stop, Role.OPERATOR),
        post("/run/step", _step, Role.OPERATOR),
        post("/run/clear", _clear, Role.OPERATOR),
        post("/run/look", _look, Role.OPERATOR),
        post("/run/verify", _verify, Role.OPERATOR),
        post("/run/resolve", _resolve, Role.OPERATOR),
        post("/run/abandon", _abandon, Role.ENGINEER),
    ),
)
