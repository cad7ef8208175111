"""Can this be laid?  A template is checked: a file that is sent, CSV or DXF, or that of a recipe.

Both run on the bench: what is sent may have been made to break its reader.  To keep a template, save it with the
parameters of a recipe (`recipe_work`); to lay it, activate that.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Call, Endpoint, Query
from slabcell.service.api.resources.recipes import known_path
from slabcell.service.bench.wire import Json
from slabcell.template.dxf import Unit

__all__ = ["ENDPOINTS"]

TEMPLATE_BYTES: Final = 8 << 20
CHECK_TIMEOUT_S: Final = 60.0
Value = str | int | float


class TemplateQuery(Query):
    """How a drawing is read, and for which recipe."""

    recipe: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        default=None, description="whose gripper and matching are asked; none: the active recipe"
    )
    unit: Unit | None = Field(default=None, description="unit of a drawing; none: as it says")
    layers: Annotated[str, Field(max_length=400)] = Field(
        default="", description="layers of the slabs in a drawing, with commas between; empty: all that are shown"
    )


class SlotDocument(Document):
    """One polygon of a template."""

    slot: int
    name: str = Field(description="what people call it; empty if it has no name")
    outline_mm: list[tuple[float, float]]
    area_mm2: float
    thickness_mm: float | None = Field(description="as the drawing says it; null for CSV, and where it says none")


class FindingDocument(Document):
    """Something that is wrong with a template, or worth knowing, and where."""

    kind: str = Field(description="what it is, for programs and for other languages")
    advice: bool = Field(description="worth knowing; if not, the template cannot be used")
    place: str = Field(description="where in the file: line and column, or entity and layer; may be empty")
    text: str = Field(description="in English")
    values: dict[str, Value] = Field(description="the numbers and names of the text")
    slots: list[int]
    at_mm: tuple[float, float] | None = Field(description="where on the pattern; null if that is not known")
    outlines_mm: list[list[tuple[float, float]]] = Field(description="what it is about, drawn")


class TemplateDocument(Document):
    """A template, and everything that is found about it."""

    schema_: Literal["slabcell.template-check/1"] = Field(default="slabcell.template-check/1", alias="schema")
    usable: bool
    problems: list[str] = Field(description="what is wrong, each with its place; empty if it can be used")
    findings: list[FindingDocument] = Field(description="the same, and what is worth knowing, with where it is")
    slots: list[SlotDocument] = Field(description="those that could be read")
    csv: str = Field(description="the template that a drawing makes; empty for CSV")
    sha256: str


async def _check(call: Call[ApiContext]) -> TemplateDocument:
    said: TemplateQuery = call.query
    layers = [name.strip() for name in said.layers.split(",") if name.strip()]
    arguments: Json = {"unit": said.unit, "layers": layers}
    return await _examine(call.context, said.recipe or call.context.cell.recipe.name, arguments, (call.raw,))


async def _of_recipe(call: Call[ApiContext]) -> TemplateDocument:
    return await _examine(call.context, call.text("name"), {}, ())


async def _examine(context: ApiContext, recipe: str, arguments: Json, blobs: tuple[bytes, ...]) -> TemplateDocument:
    path = await known_path(context, recipe)
    done = await context.studio.bench.run("template", {"recipe": path, **arguments}, blobs, timeout_s=CHECK_TIMEOUT_S)
    problems = [
        ": ".join(filter(None, [f"template:{item['place']}" if item["place"] else "template", item["text"]]))
        for item in done.content["findings"]
        if not item["advice"]
    ]
    return TemplateDocument(problems=problems, **done.content)


_TAG = "recipes"
ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/templates/check", "Say everything that is wrong with a template, CSV or DXF", _check),
        *(TemplateDocument, _TAG),
        query=TemplateQuery,
        raw="application/octet-stream",
        body_bytes=TEMPLATE_BYTES,
        kept=False,
        problems=(404, 503),
    ),
    Endpoint(
        *("GET", "/v1/recipes/{name}/template", "The template of a recipe, and what is found about it", _of_recipe),
        *(TemplateDocument, _TAG),
        problems=(404, 422, 503),
    ),
)
