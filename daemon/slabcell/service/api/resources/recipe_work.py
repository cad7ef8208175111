"""How does a recipe become better?  Saved as a new version or under a new name, compared, graded, verified."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from slabcell.cell.bundle_file import BundleError
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Body, Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.resources.cycles import cycle_row
from slabcell.service.api.resources.recipes import GRADING_TIMEOUT_S, grading_arguments, known_path, recipes_of
from slabcell.service.api.resources.tasks import TaskDocument, task_view
from slabcell.service.api.resources.vision import CANDIDATE_BYTES, CandidateBody, ParametersBody, candidate_of
from slabcell.service.bench.wire import Json
from slabcell.service.recipe_difference import differences
from slabcell.service.recipe_schema import unit_of
from slabcell.service.recipes import add_graded

__all__ = ["ENDPOINTS"]

Progress = Callable[[Json], None]


class SaveBody(ParametersBody):
    """What is saved, and as what."""

    name: Annotated[str, Field(min_length=1, max_length=60)] | None = Field(
        default=None,
        description="name of a new recipe, which has a graded set of its own; none: a version of the base, NAME~3",
    )


class SavedDocument(Document):
    """A new version of a recipe."""

    schema_: Literal["slabcell.recipe-saved/1"] = Field(default="slabcell.recipe-saved/1", alias="schema")
    name: str = Field(description="what it is called, as NAME~3; it is not active yet")


class ChangeDocument(Document):
    """One parameter that two recipes have otherwise."""

    key: str = Field(description="as in a recipe's file, such as matching.min_score")
    unit: str = Field(description="empty for none")
    active: Any
    candidate: Any


class DifferenceDocument(Document):
    """In what a recipe that somebody is working on differs from the active one."""

    schema_: Literal["slabcell.recipe-difference/1"] = Field(default="slabcell.recipe-difference/1", alias="schema")
    active: str = Field(description="name of the active recipe")
    base: str = Field(description="name of the recipe that the other one is based on")
    template_changed: bool
    changes: list[ChangeDocument]


class GradeBody(Body):
    """Which cycle a person has found right."""

    cycle: Annotated[int, Field(ge=1)] = Field(description="number of an ended cycle whose bundle is kept")


async def _save(call: Call[ApiContext]) -> SavedDocument:
    context, name = call.context, call.text("name")
    await known_path(context, name)
    candidate = await candidate_of(context, name, call.body)
    said: SaveBody = call.body
    return SavedDocument(name=await asyncio.to_thread(recipes_of(context).save, name, candidate, said.name))


async def _compare(call: Call[ApiContext]) -> DifferenceDocument:
    context, said = call.context, call.body
    active = context.cell.recipe
    base = said.base or active.name
    await known_path(context, base)
    candidate = (await candidate_of(context, base, said)).recipe
    return DifferenceDocument(
        active=active.name,
        base=base,
        template_changed=candidate.template.sha256 != active.template.sha256,
        changes=[
            ChangeDocument(key=item.key, unit=unit_of(item.key), active=item.before, candidate=item.after)
            for item in differences(active, candidate)
        ],
    )


async def _verify(call: Call[ApiContext]) -> TaskDocument:
    context, name = call.context, call.text("name")
    arguments = await grading_arguments(context, name)

    async def work(progress: Progress) -> Json:
        done = await context.studio.bench.run("grade", arguments, timeout_s=GRADING_TIMEOUT_S, progress=progress)
        return {"schema": "slabcell.recipe-verification/1", **done.content}

    task = context.studio.background.start("verify-recipe", f"run the graded set of {name}", work)
    return task_view(task)


async def _grade(call: Call[ApiContext]) -> Done:
    context, name = call.context, call.text("name")
    path = Path(await known_path(context, name))
    row = await cycle_row(context, call.body.cycle)
    folder = recipes_of(context).graded(name)[-1]
    try:
        bundle = await asyncio.to_thread(context.bundles.path, row.bundle)
    except BundleError as error:
        raise ProblemError(404, str(error)) from error
    (kept,) = await asyncio.to_thread(lambda: add_graded(path, [bundle], folder=folder))
    return Done(detail=f"{kept.name} belongs to the graded set of {name}")


_TAG = "recipes"
ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/recipes/{name}/versions", "Save parameters as a new version; it is not active yet", _save),
        *(SavedDocument, _TAG),
        body=SaveBody,
        body_bytes=CANDIDATE_BYTES,
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/recipes/compare", "Say in what parameters differ from those of the active recipe", _compare),
        *(DifferenceDocument, _TAG),
        body=CandidateBody,
        body_bytes=CANDIDATE_BYTES,
        problems=(404,),
        kept=False,
    ),
    Endpoint(
        *("POST", "/v1/recipes/{name}/verify", "Run the recipe on its graded pictures, in the background", _verify),
        *(TaskDocument, _TAG),
        problems=(404, 503),
    ),
    Endpoint(
        *("POST", "/v1/recipes/{name}/grade", "Add a cycle that a person has found right to the graded set", _grade),
        *(Done, _TAG),
        body=GradeBody,
        problems=(404,),
    ),
)
