"""How do parameters that were tried become the cell's?  Compared, saved, checked on graded pictures, then applied."""

from __future__ import annotations

from urllib.parse import quote

from starlette.responses import JSONResponse, Response

from slabcell.hmi.cell_api import Json
from slabcell.hmi.pages.tune.answers import answer, ask, json_post, said
from slabcell.hmi.route import get
from slabcell.hmi.security.roles import Role
from slabcell.hmi.visit import Visit

__all__ = ["ROUTES"]

ACTIVATION_S = 120.0
"""The daemon runs the graded pictures once more before it changes."""


def _path(name: object, *rest: str) -> str:
    return "/".join(["/v1/recipes", quote(str(name), safe="~"), *rest])


async def _recipe(visit: Visit) -> Response:
    """Return a recipe's parameters, and those of the active one."""
    active = str((await visit.hmi.api.get("/v1/status"))["recipe"])
    found = await visit.hmi.api.get(_path(visit.text("name") or active))
    known = found if found["name"] == active else await visit.hmi.api.get(_path(active))
    return JSONResponse(
        {
            "name": found["name"],
            "parameters": found["parameters"],
            "slots": len(found["recipe"]["template"]["slots"]),
            "graded": found["graded"],
            "active": {"name": active, "parameters": known["parameters"]},
        }
    )


async def _active(visit: Visit) -> Response:
    """Return the active recipe's name as the HMI knows it: the cell is not asked."""
    status = visit.hmi.link.status
    return JSONResponse({"name": status["recipe"] if status else ""})


async def _compare(visit: Visit) -> Response:
    content = said(visit)
    return await answer(visit, ask(visit, "/v1/recipes/compare", _candidate(content)))


async def _check(visit: Visit) -> Response:
    """Have graded pictures looked at with these parameters: as the recipe that has them, or as a new version of it."""
    content = said(visit, "base")
    base = content.get("base", "")

    async def work() -> Json:
        name = base
        if content.get("changed"):
            name = (await ask(visit, _path(base, "versions"), {"parameters": content.get("parameters")}))["name"]
        task = await ask(visit, _path(name, "verify"))
        visit.outcome = f"{name}: task {task['task']}"
        return {"name": name, "task": task["task"]}

    return await answer(visit, work())


async def _apply(visit: Visit) -> Response:
    content = said(visit, "name")

    async def work() -> Json:
        done = await ask(visit, _path(content.get("name", ""), "activate"), timeout_s=ACTIVATION_S)
        visit.outcome = str(done["detail"])
        return done

    return await answer(visit, work())


async def _grade(visit: Visit) -> Response:
    content = said(visit, "recipe", "cycle")
    return await answer(visit, ask(visit, _path(content.get("recipe", ""), "grade"), {"cycle": content.get("cycle")}))


def _candidate(content: Json) -> Json:
    return {name: content[name] for name in ("base", "parameters") if name in content}


ROUTES = (
    get("/tune/recipe", _recipe, Role.ENGINEER),
    get("/tune/active", _active, Role.ENGINEER),
    json_post("/tune/compare", _compare, logged=False),
    json_post("/tune/check", _check),
    json_post("/tune/apply", _apply),
    json_post("/tune/grade", _grade),
)
