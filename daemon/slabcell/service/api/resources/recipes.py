"""Which products does the cell know, and which one is active?"""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field

from slabcell.cell.bundle import recipe_document
from slabcell.errors import RecipeError, SlabcellError
from slabcell.recipe import RecipeFile, load_recipe
from slabcell.service.active_recipe import RecipeShelf
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document, Done
from slabcell.service.api.endpoint import Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.recipe_schema import recipe_schema
from slabcell.service.recipes import DEFAULT_DEG, DEFAULT_MM, Verification
from slabcell.toml_file import read_toml

__all__ = ["ENDPOINTS", "GRADING_TIMEOUT_S", "grading_arguments", "known_path", "recipes_of"]

GRADING_TIMEOUT_S: Final = 1800.0
ACTIVATION_TIMEOUT_S: Final = 110.0


class RecipeDocument(Document):
    """One recipe file."""

    name: str
    root: str = Field(description="the recipe that it is a version of")
    version: int = Field(description="0, or which saved version of its root it is")
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


class WholeRecipeDocument(Document):
    """One recipe, as it is written and as the cell understands it."""

    schema_: Literal["slabcell.recipe-file/1"] = Field(default="slabcell.recipe-file/1", alias="schema")
    name: str
    active: bool
    toml: str = Field(description="the file, word for word")
    parameters: dict[str, Any] = Field(description="every value of the file, defaults included")
    recipe: dict[str, Any] = Field(description="a slabcell.recipe/1 object, with the template")
    graded: list[str] = Field(description="the pictures that it has to pass")


class RecipeSchemaDocument(Document):
    """What may stand in a recipe."""

    schema_: Literal["slabcell.recipe-schema/1"] = Field(default="slabcell.recipe-schema/1", alias="schema")
    json_schema: dict[str, Any] = Field(
        description="a JSON schema: types, ranges, defaults, descriptions, and x-unit for the unit of a number"
    )


def recipes_of(context: ApiContext) -> RecipeShelf:
    """Return the recipes of the cell.  Raises ProblemError 404."""
    if context.recipes is None:
        raise ProblemError(404, "this daemon has no folder of recipes")
    return context.recipes


async def known_path(context: ApiContext, name: str) -> str:
    """Return the file of a recipe.  Raises ProblemError 404."""
    shelf = recipes_of(context)
    try:
        return str(await asyncio.to_thread(shelf.path_of, name))
    except SlabcellError as error:
        raise ProblemError(404, str(error), number=error.number) from error


async def grading_arguments(context: ApiContext, name: str) -> dict[str, object]:
    """Return what the bench needs to run a recipe's graded set.  Raises ProblemError 404."""
    return {
        "recipe": await known_path(context, name),
        "graded": [str(folder) for folder in recipes_of(context).graded(name)],
        "tolerance_mm": DEFAULT_MM,
        "tolerance_deg": DEFAULT_DEG,
    }


async def _list(call: Call[ApiContext]) -> RecipesDocument:
    if call.context.recipes is None:
        return RecipesDocument(recipes=[])
    entries = await asyncio.to_thread(call.context.recipes.entries)
    active = call.context.cell.recipe.name
    return RecipesDocument(
        recipes=[
            RecipeDocument(
                name=item.name,
                root=item.root,
                version=item.version,
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


async def _schema(_: Call[ApiContext]) -> RecipeSchemaDocument:
    return RecipeSchemaDocument(json_schema=recipe_schema())


async def _one(call: Call[ApiContext]) -> WholeRecipeDocument:
    name, shelf = call.text("name"), recipes_of(call.context)
    found = await known_path(call.context, name)
    return await asyncio.to_thread(_whole, shelf, name, found, active=name == call.context.cell.recipe.name)


def _whole(shelf: RecipeShelf, name: str, file: str, *, active: bool) -> WholeRecipeDocument:
    path = Path(file)
    return WholeRecipeDocument(
        name=name,
        active=active,
        toml=path.read_text(encoding="utf-8", errors="replace"),
        parameters=read_toml(path, RecipeFile, RecipeError).model_dump(mode="json"),
        recipe=recipe_document(load_recipe(path)),
        graded=sorted(item.name for folder in shelf.graded(name) for item in folder.glob("*.zip")),
    )


async def _activate(call: Call[ApiContext]) -> Done:
    context, name = call.context, call.text("name")
    shelf = recipes_of(context)
    arguments = await grading_arguments(context, name)
    try:
        recipe = await asyncio.to_thread(load_recipe, shelf.path_of(name))
        done = await context.studio.bench.run("grade", arguments, timeout_s=ACTIVATION_TIMEOUT_S)
        Verification.from_document(done.content).require()
    except SlabcellError as error:
        raise ProblemError(422, str(error), number=error.number) from error
    await context.cell.change(recipe=recipe)
    await asyncio.to_thread(shelf.choose, name)
    pictures = len(done.content["pictures"])
    found = f"{pictures} graded pictures found again" if pictures else "no graded set to pass"
    slots = len(recipe.template.slots)
    return Done(detail=f"recipe {name} with {slots} slots is active, for restarts too; {found}")


_TAG = "recipes"
ENDPOINTS = (
    Endpoint("GET", "/v1/recipes", "Every recipe, and what is wrong with it", _list, RecipesDocument, _TAG),
    Endpoint("GET", "/v1/recipes/active", "The active recipe", _active, ActiveRecipeDocument, _TAG),
    Endpoint(
        *("GET", "/v1/recipes/schema", "What may stand in a recipe: types, ranges, units, help", _schema),
        *(RecipeSchemaDocument, _TAG),
    ),
    Endpoint(
        *("GET", "/v1/recipes/{name}", "One recipe, whole", _one, WholeRecipeDocument, _TAG),
        problems=(404, 422),
    ),
    Endpoint(
        *("POST", "/v1/recipes/{name}/activate", "Work with another recipe; between jobs only", _activate, Done),
        _TAG,
        problems=(404, 503),
    ),
)
