"""Which products does the cell know, which one is active, and with which calibration does it look?"""

from __future__ import annotations

import asyncio
from typing import Any, Literal

from pydantic import Field

from slabcell.calibration.file import to_document
from slabcell.cell.bundle import recipe_document
from slabcell.errors import SlabcellError
from slabcell.recipe import load_recipe
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.recipes import verify

__all__ = ["ENDPOINTS"]


class RecipeDocument(Document):
    """One recipe file."""

    name: str
    active: bool
    sha256: str = Field(description="of the file")
    slots: int
    template_sha256: str
    problem: str = Field(description="what is wrong with it; empty if nothing is")


class RecipesDocument(Document):
    """Every recipe of the cell."""

    schema_: Literal["slabcell.recipes/1"] = Field(default="slabcell.recipes/1", alias="schema")
    recipes: list[RecipeDocument]


class ActiveRecipeDocument(Document):
    """The recipe that the cell works with, every parameter and its template."""

    schema_: Literal["slabcell.active/1"] = Field(default="slabcell.active/1", alias="schema")
    recipe: dict[str, Any] = Field(description="a slabcell.recipe/1 object")


class CalibrationDocument(Document):
    """The calibration that the cell works with."""

    schema_: Literal["slabcell.cell-calibration/1"] = Field(default="slabcell.cell-calibration/1", alias="schema")
    calibration: dict[str, Any] = Field(description="a slabcell.calibration/1 object")


async def _list(call: Call[ApiContext]) -> RecipesDocument:
    if call.context.recipes is None:
        return RecipesDocument(recipes=[])
    entries = await asyncio.to_thread(call.context.recipes.entries)
    active = call.context.cell.recipe.name
    return RecipesDocument(
        recipes=[
            RecipeDocument(
                name=item.name,
                active=item.name == active,
                sha256=item.sha256,
                slots=item.slots,
                template_sha256=item.template_sha256,
                problem=item.problem,
            )
            for item in entries
        ]
    )


async def _active(call: Call[ApiContext]) -> ActiveRecipeDocument:
    return ActiveRecipeDocument(recipe=recipe_document(call.context.cell.recipe))


async def _activate(call: Call[ApiContext]) -> Done:
    shelf, name = call.context.recipes, call.text("name")
    if shelf is None:
        raise ProblemError(404, "this daemon has no folder of recipes")
    try:
        path = await asyncio.to_thread(shelf.path_of, name)
        recipe = await asyncio.to_thread(load_recipe, path)
        done = await asyncio.to_thread(verify, path)
        done.require()
    except SlabcellError as error:
        raise ProblemError(422, str(error), number=error.number) from error
    await call.context.cell.change(recipe=recipe)
    await asyncio.to_thread(shelf.choose, name)
    found = f"{len(done.pictures)} graded pictures found again" if done.pictures else "no graded set to pass"
    slots = len(recipe.template.slots)
    return Done(detail=f"recipe {name} with {slots} slots is active, for restarts too; {found}")


async def _calibration(call: Call[ApiContext]) -> CalibrationDocument:
    return CalibrationDocument(calibration=dict(to_document(call.context.cell.calibration)))


ENDPOINTS = (
    Endpoint("GET", "/v1/recipes", "Every recipe, and what is wrong with it", _list, RecipesDocument, "recipes"),
    Endpoint("GET", "/v1/recipes/active", "The active recipe", _active, ActiveRecipeDocument, "recipes"),
    Endpoint(
        *("POST", "/v1/recipes/{name}/activate", "Work with another recipe; between jobs only", _activate, Done),
        "recipes",
        problems=(404,),
    ),
    Endpoint(
        *("GET", "/v1/calibration", "The calibration that is in use", _calibration, CalibrationDocument),
        "calibration",
    ),
)
