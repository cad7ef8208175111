"""Which application answers at the socket?  Every endpoint, and problems for everything else."""

from __future__ import annotations

import json
from http import HTTPStatus

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from slabcell.service.api.context import ApiContext
from slabcell.service.api.endpoint import Endpoint, make_route
from slabcell.service.api.idempotency import Once
from slabcell.service.api.openapi import describe
from slabcell.service.api.problems import ProblemError, respond
from slabcell.service.api.resources import (
    alarms,
    calibration,
    calibration_checks,
    calibration_views,
    control,
    cycles,
    doctor,
    events,
    frames,
    jobs,
    looking,
    metrics,
    picture_sets,
    placements,
    recipe_work,
    recipes,
    results,
    robot_pose,
    simulation,
    status,
    tasks,
    templates,
    vision,
)

__all__ = ["ENDPOINTS", "description", "make_app"]

ENDPOINTS: tuple[Endpoint[ApiContext], ...] = (
    *status.ENDPOINTS,
    *jobs.ENDPOINTS,
    *cycles.ENDPOINTS,
    *placements.ENDPOINTS,
    *results.ENDPOINTS,
    *recipes.ENDPOINTS,
    *recipe_work.ENDPOINTS,
    *templates.ENDPOINTS,
    *calibration.ENDPOINTS,
    *calibration_views.ENDPOINTS,
    *robot_pose.ENDPOINTS,
    *calibration_checks.ENDPOINTS,
    *frames.ENDPOINTS,
    *looking.ENDPOINTS,
    *vision.ENDPOINTS,
    *picture_sets.ENDPOINTS,
    *tasks.ENDPOINTS,
    *alarms.ENDPOINTS,
    *control.ENDPOINTS,
    *doctor.ENDPOINTS,
    *events.ENDPOINTS,
    *metrics.ENDPOINTS,
    *simulation.ENDPOINTS,
)


def description() -> dict[str, object]:
    """Return the OpenAPI description of everything that is served."""
    return describe(ENDPOINTS)


def make_app(context: ApiContext) -> Starlette:
    """Return the application for a running cell."""
    once = Once(context.history)
    content = Response(json.dumps(description()), media_type="application/json")

    async def openapi(_: Request) -> Response:
        return content

    return Starlette(
        routes=[
            Route("/v1/openapi.json", openapi, methods=["GET"]),
            *(make_route(endpoint, context, once, pause=context.pause) for endpoint in ENDPOINTS),
        ],
        exception_handlers={HTTPException: _refuse},
    )


async def _refuse(request: Request, error: Exception) -> Response:
    status_code = error.status_code if isinstance(error, HTTPException) else HTTPStatus.INTERNAL_SERVER_ERROR
    what = "there is no such resource" if status_code == HTTPStatus.NOT_FOUND else "this method is not possible here"
    return respond(ProblemError(int(status_code), f"{request.method} {request.url.path:.100}: {what}"))
