"""What does Prometheus read?  Every metric, in its text format."""

from __future__ import annotations

from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import Response

from slabcell.service.api.context import ApiContext
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError

__all__ = ["ENDPOINTS"]


async def _metrics(call: Call[ApiContext]) -> Response:
    if call.context.metrics is None:
        raise ProblemError(404, "this daemon keeps no metrics")
    return Response(call.context.metrics(), headers={"content-type": CONTENT_TYPE_LATEST})


ENDPOINTS = (Endpoint("GET", "/metrics", "Metrics for Prometheus", _metrics, "text/plain", "metrics", problems=(404,)),)
