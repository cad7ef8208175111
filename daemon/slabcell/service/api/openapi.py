"""How is the API described?  As an OpenAPI 3.1 document, made from the declarations that the routes are made from.

Source: OpenAPI Specification 3.1.0.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from http import HTTPStatus
from typing import Any, Final

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from slabcell.service.api.endpoint import Endpoint
from slabcell.service.api.problems import MEDIA_TYPE, Problem

__all__ = ["API_VERSION", "describe"]

API_VERSION: Final = "1.0.0"
_REFERENCE: Final = "#/components/schemas/{model}"
_SEPARATORS: Final = re.compile(r"[/{}.]+")
_PARAMETER: Final = re.compile(r"\{(\w+)(?::\w+)?\}")

_KEY: Final[dict[str, Any]] = {
    "name": "Idempotency-Key",
    "in": "header",
    "required": True,
    "description": "A new one for each new write, such as a UUID; the same request again gets the same answer.",
    "schema": {"type": "string", "pattern": r"^\"?[A-Za-z0-9._:\-]{8,64}\"?$"},
}

Json = dict[str, Any]


def describe(endpoints: Iterable[Endpoint[Any]]) -> Json:
    """Return the description of these endpoints."""
    known = tuple(endpoints)
    models = _models(known)
    _, definitions = models_json_schema([(model, "serialization") for model in models], ref_template=_REFERENCE)
    paths: dict[str, Json] = {}
    for endpoint in known:
        path = _PARAMETER.sub(r"{\1}", endpoint.path)
        paths.setdefault(path, {})[endpoint.method.lower()] = _operation(endpoint, definitions["$defs"])
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "slabcell control API",
            "version": API_VERSION,
            "description": (
                "HTTP and server-sent events on the daemon's Unix socket. Nothing here moves the robot: the robot asks,"
                " the cell answers."
            ),
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "servers": [{"url": "http://localhost", "description": "the Unix socket of the daemon"}],
        "paths": paths,
        "components": {"schemas": definitions["$defs"]},
    }


def _models(endpoints: tuple[Endpoint[Any], ...]) -> list[type[BaseModel]]:
    """Return every model that is spoken of, each once, in the order of the endpoints."""
    found: dict[type[BaseModel], None] = {Problem: None}
    for endpoint in endpoints:
        for model in (endpoint.answer, endpoint.body, endpoint.query):
            if isinstance(model, type):
                found[model] = None
    return list(found)


def _operation(endpoint: Endpoint[Any], definitions: Json) -> Json:
    name = _SEPARATORS.sub("_", endpoint.path.removeprefix("/v1")).strip("_")
    operation: Json = {
        "operationId": f"{endpoint.method.lower()}_{name}",
        "summary": endpoint.summary,
        "tags": [endpoint.tag],
        "responses": {
            "200": {"description": "Done" if endpoint.writes else "Found", "content": _content(endpoint.answer)},
            **{str(status): _problem(status) for status in _problems(endpoint)},
        },
    }
    parameters = [*_path_parameters(endpoint), *_query_parameters(endpoint, definitions)]
    if endpoint.keyed:
        parameters.append(_KEY)
    if parameters:
        operation["parameters"] = parameters
    if endpoint.raw is not None:
        operation["requestBody"] = {"required": True, "content": {endpoint.raw: {"schema": {}}}}
    elif endpoint.body is not None:
        operation["requestBody"] = {"required": True, "content": _content(endpoint.body)}
    return operation


def _content(answer: type[BaseModel] | str) -> Json:
    if isinstance(answer, str):
        text = answer.startswith("text/")
        return {answer: {"schema": {"type": "string"} if text else {}}}
    return {"application/json": {"schema": {"$ref": _REFERENCE.format(model=answer.__name__)}}}


def _problems(endpoint: Endpoint[Any]) -> list[int]:
    found = {*endpoint.problems}
    if endpoint.writes:
        found |= {400, 409, 413, 422}
    elif endpoint.query is not None:
        found |= {422}
    return sorted(found)


def _problem(status: int) -> Json:
    return {"description": HTTPStatus(status).phrase, "content": {MEDIA_TYPE: _content(Problem)["application/json"]}}


def _path_parameters(endpoint: Endpoint[Any]) -> list[Json]:
    return [
        {"name": name, "in": "path", "required": True, "schema": {"type": "string"}}
        for name in _PARAMETER.findall(endpoint.path)
    ]


def _query_parameters(endpoint: Endpoint[Any], definitions: Json) -> list[Json]:
    """Return the parameters of a query model, which is no schema of its own then."""
    if endpoint.query is None:
        return []
    schema = definitions[endpoint.query.__name__]
    return [
        {
            "name": name,
            "in": "query",
            "required": name in schema.get("required", ()),
            "description": field.get("description", ""),
            "schema": {key: value for key, value in field.items() if key not in {"description", "title"}},
        }
        for name, field in schema["properties"].items()
    ]
