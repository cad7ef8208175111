"""On which pictures are parameters tried?  Sets that are kept, graded pictures, cycles; and a run over many at once.

A run is a task: one picture after the other on the bench, so that other work there comes in between.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Body, Call, Endpoint, Query
from slabcell.service.api.problems import ProblemError
from slabcell.service.api.resources.recipes import recipes_of
from slabcell.service.api.resources.tasks import TaskDocument, task_view
from slabcell.service.api.resources.vision import (
    CANDIDATE_BYTES,
    PREVIEW_TIMEOUT_S,
    CandidateBody,
    chosen_picture,
    recipe_of,
    vision_arguments,
)
from slabcell.service.bench.wire import Json
from slabcell.service.bench.work import pixels_of
from slabcell.service.frames import PictureFormat
from slabcell.service.picture_sets import MAX_PICTURES, NoSuchPictureError
from slabcell.service.pictures import Picture

__all__ = ["ENDPOINTS"]

LAST_CYCLES: Final = 30
Progress = Callable[[Json], None]


class SetPictureDocument(Document):
    """One picture to work on."""

    picture: str = Field(description="what to call it in other requests")
    name: str = Field(description="what people call it")


class PictureSetDocument(Document):
    """Pictures that belong together."""

    name: str
    kind: Literal["stored", "graded", "cycles"] = Field(
        description="a set that is kept to tune on, the graded pictures of a recipe, or the last cycles"
    )
    pictures: list[SetPictureDocument]


class PictureSetsDocument(Document):
    """Every picture that is kept."""

    schema_: Literal["slabcell.picture-sets/1"] = Field(default="slabcell.picture-sets/1", alias="schema")
    sets: list[PictureSetDocument]


class SetsQuery(Query):
    """Whose graded pictures."""

    recipe: Annotated[str, Field(max_length=200)] | None = Field(
        default=None, description="name of a recipe; none: the active one"
    )


class KeepBody(Body):
    """Which picture."""

    picture: Annotated[str, Field(max_length=300)] = Field(
        default="latest", description="latest, cycle:NUMBER, upload:ID, or one of another set"
    )
    name: Annotated[str, Field(max_length=60)] = Field(default="", description="what people call it; empty: the moment")


class RemoveBody(Body):
    """Which picture."""

    file: Annotated[str, Field(max_length=80)] = Field(description="name of its file in the set")


class RunBody(CandidateBody):
    """Which pictures, and which recipe."""

    pictures: Annotated[list[Annotated[str, Field(max_length=300)]], Field(min_length=1, max_length=MAX_PICTURES)] = (
        Field(description="as preview takes them")
    )
    everywhere: bool = Field(default=False, description="look at the whole picture, not at the pick area only")


async def _sets(call: Call[ApiContext]) -> PictureSetsDocument:
    context = call.context
    stored = await asyncio.to_thread(context.studio.pictures.sets.sets)
    sets = [
        PictureSetDocument(
            name=item.name,
            kind="stored",
            pictures=[
                SetPictureDocument(picture=f"set:{item.name}/{picture.name}", name=picture.name)
                for picture in item.pictures
            ],
        )
        for item in stored
    ]
    if context.recipes is not None:
        recipe = call.query.recipe or context.cell.recipe.name
        sets.append(await asyncio.to_thread(_graded, recipes_of(context), recipe))
    return PictureSetsDocument(sets=[*sets, await _cycles(context)])


def _graded(shelf: RecipeShelf, recipe: str) -> PictureSetDocument:
    shelf.path_of(recipe)  # a recipe that is not there has no set
    names = sorted(file.name for folder in shelf.graded(recipe) for file in folder.glob("*.zip"))
    pictures = [SetPictureDocument(picture=f"graded:{recipe}/{name}", name=name) for name in names]
    return PictureSetDocument(name=recipe, kind="graded", pictures=pictures)


async def _cycles(context: ApiContext) -> PictureSetDocument:
    rows = await context.history.read(lambda file: file.cycles(before=1 << 60, limit=LAST_CYCLES))
    pictures = [
        SetPictureDocument(picture=f"cycle:{row.number}", name=f"{row.number} {row.began_utc}")
        for row in rows
        if row.bundle
    ]
    return PictureSetDocument(name="", kind="cycles", pictures=pictures)


async def _keep(call: Call[ApiContext]) -> SetPictureDocument:
    context, said, name = call.context, call.body, call.text("set")
    picture = await chosen_picture(context, said.picture)
    raw = await _as_file(context, picture)
    file = await asyncio.to_thread(context.studio.pictures.sets.add, name, raw, said.name)
    return SetPictureDocument(picture=f"set:{name}/{file}", name=file)


async def _as_file(context: ApiContext, picture: Picture) -> bytes:
    """Return a picture as a file: as it came, or as PNG where it is pixels."""
    if not picture.arguments:
        return bytes(picture.blob)
    return await context.frames.encode(pixels_of(picture.arguments, picture.blob), PictureFormat.PNG)


async def _remove(call: Call[ApiContext]) -> Done:
    name, file = call.text("set"), call.body.file
    try:
        await asyncio.to_thread(call.context.studio.pictures.sets.remove, name, file)
    except NoSuchPictureError as error:
        raise ProblemError(404, str(error)) from error
    return Done(detail=f"{file} is removed from set {name}")


async def _run(call: Call[ApiContext]) -> TaskDocument:
    context, said = call.context, call.body
    recipe = await recipe_of(context, said)
    arguments = {**vision_arguments(context, recipe, everywhere=said.everywhere), "buffers": False}

    async def work(progress: Progress) -> Json:
        found: list[Json] = []
        for number, name in enumerate(said.pictures):
            progress({"done": number, "total": len(said.pictures), "doing": name})
            picture = await chosen_picture(context, name)
            asked = {**picture.arguments, **arguments, "name": picture.name}
            done = await context.studio.bench.run("preview", asked, (picture.blob,), timeout_s=PREVIEW_TIMEOUT_S)
            found.append(_row(name, done.content))
        return {"schema": "slabcell.vision-run/1", "recipe": recipe.name, "pictures": found}

    title = f"look at {len(said.pictures)} pictures with {recipe.name}"
    return task_view(context.studio.background.start("vision-run", title, work))


def _row(name: str, content: dict[str, Any]) -> Json:
    """Return what came of one picture, without outlines."""
    located: Json = content["located"] or {"parts": [], "rejected": [], "empty_slots": [], "timing_ms": {}}
    return {
        "picture": name,
        "slots": [part["slot"] for part in located["parts"]],
        "rejected": [blob["reason"] for blob in located["rejected"]],
        "empty_slots": located["empty_slots"],
        "worst_residual_mm": max((part["residual_mm"] for part in located["parts"]), default=None),
        "timing_ms": located["timing_ms"],
        "refusal": content["refusal"],
        "segmentation": content["segmentation"],
    }


_TAG = "vision"
ENDPOINTS = (
    Endpoint(
        *("GET", "/v1/vision/sets", "Pictures to try parameters on: kept sets, graded pictures, cycles", _sets),
        *(PictureSetsDocument, _TAG),
        query=SetsQuery,
    ),
    Endpoint(
        *("POST", "/v1/vision/sets/{set}/keep", "Keep a picture in a set, which begins with its first", _keep),
        *(SetPictureDocument, _TAG),
        body=KeepBody,
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/vision/sets/{set}/remove", "Remove a picture from a set, which ends with its last", _remove),
        *(Done, _TAG),
        body=RemoveBody,
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/vision/run", "Run the vision on many pictures, in the background", _run),
        *(TaskDocument, _TAG),
        body=RunBody,
        body_bytes=CANDIDATE_BYTES,
        problems=(404, 503),
        kept=False,
    ),
)
