"""What would the vision make of a picture with other parameters?  Nothing becomes active, nothing is written.

The work is done by the bench (`slabcell.service.bench`), beside the cell and at its leisure.
"""

from __future__ import annotations

import asyncio
from typing import Annotated, Any, Final, Literal

from pydantic import Field
from starlette.responses import Response

from slabcell.calibration.file import to_document
from slabcell.cell.bundle import recipe_document
from slabcell.cell.preparing import require_calibration
from slabcell.recipe import Recipe
from slabcell.service.api.context import ApiContext
from slabcell.service.api.documents import Document
from slabcell.service.api.endpoint import Body, Call, Endpoint
from slabcell.service.api.problems import ProblemError
from slabcell.service.bench.preview import BUFFERS
from slabcell.service.candidate import Candidate, make_candidate
from slabcell.service.pictures import MAX_UPLOAD_BYTES, NoSuchPictureError, Picture
from slabcell.service.studio import Preview

__all__ = [
    "CANDIDATE_BYTES",
    "ENDPOINTS",
    "PREVIEW_TIMEOUT_S",
    "TEMPLATE_CHARACTERS",
    "CandidateBody",
    "ParametersBody",
    "candidate_of",
    "chosen_picture",
    "recipe_of",
    "vision_arguments",
]

PARAMETER_BYTES: Final = 512 << 10
TEMPLATE_CHARACTERS: Final = 2 << 20
"""As many as the most slots that a template may have take with twenty corners each, to a hundredth of a millimetre."""
CANDIDATE_BYTES: Final = 3 * PARAMETER_BYTES + TEMPLATE_CHARACTERS + (64 << 10)
"""What a request with such a recipe may carry: a template's line ends take a byte more each in JSON."""
PREVIEW_TIMEOUT_S: Final = 30.0


class ParametersBody(Body):
    """What a recipe would say; what is not given is as in the recipe that it is based on."""

    toml: Annotated[str, Field(max_length=PARAMETER_BYTES)] | None = Field(
        default=None, description="the parameters as a recipe file has them"
    )
    parameters: dict[str, Any] | None = Field(
        default=None, description="or as an object, as in the recipe's schema; template.file need not be given"
    )
    template_csv: Annotated[str, Field(max_length=TEMPLATE_CHARACTERS)] | None = Field(
        default=None, description="another template, as CSV; none: that of the base"
    )


class CandidateBody(ParametersBody):
    """A recipe that somebody is working on: parameters over those of a recipe that is there."""

    base: Annotated[str, Field(max_length=200)] | None = Field(
        default=None, description="name of the recipe that it is based on; none: the active one"
    )


class PreviewBody(CandidateBody):
    """Which picture, and which recipe."""

    picture: Annotated[str, Field(max_length=80)] = Field(
        default="latest",
        description="latest, cycle:NUMBER, set:SET/FILE, graded:RECIPE/FILE, or upload:ID of an uploaded picture",
    )
    everywhere: bool = Field(default=False, description="look at the whole picture, not at the pick area only")
    free_slots: Annotated[list[int], Field(max_length=5000)] | None = Field(
        default=None, description="slots that may be filled; none: all"
    )


class BufferDocument(Document):
    """Something to look at."""

    name: str
    media_type: str
    bytes: int
    path: str = Field(description="where it is, until the preview expires")


class PreviewDocument(Document):
    """What the vision made of a picture."""

    schema_: Literal["slabcell.preview/1"] = Field(default="slabcell.preview/1", alias="schema")
    preview: str
    picture: str
    recipe: str
    width: int
    height: int
    located: dict[str, Any] | None = Field(
        description="a slabcell.locate/1 object with outline_px for each; null if the picture was refused"
    )
    refusal: str = Field(description="why there is no result; empty if there is one")
    segmentation: str = Field(description="how slabs were told from the table")
    reduced: int = Field(description="the pictures among the buffers show every so many-th pixel")
    buffers: list[BufferDocument]
    expires_s: float = Field(description="the buffers are kept for so long")


class PictureDocument(Document):
    """An uploaded picture."""

    schema_: Literal["slabcell.picture/1"] = Field(default="slabcell.picture/1", alias="schema")
    picture: str = Field(description="what to call it, as upload:ID")
    width: int
    height: int
    expires_s: float = Field(description="it is kept for so long; uploading it again begins anew")


async def chosen_picture(context: ApiContext, name: str) -> Picture:
    """Return the picture of a name.  Raises ProblemError 404."""
    try:
        return await context.studio.pictures.choose(name)
    except NoSuchPictureError as error:
        raise ProblemError(404, str(error)) from error


async def candidate_of(context: ApiContext, base: str, said: ParametersBody) -> Candidate:
    """Return the recipe that is meant, over the recipe ``base``.

    Raises ProblemError 404, RecipeError or TemplateError.
    """
    shelf = context.recipes
    if shelf is None:
        raise ProblemError(404, "this daemon has no folder of recipes")
    path = await asyncio.to_thread(shelf.path_of, base)
    return await asyncio.to_thread(
        lambda: make_candidate(path, toml=said.toml, parameters=said.parameters, template_csv=said.template_csv)
    )


async def recipe_of(context: ApiContext, said: CandidateBody) -> Recipe:
    """Return the recipe that somebody is working on: the active one, unless something else is said.

    Raises ProblemError 404, RecipeError or TemplateError.
    """
    recipe = context.cell.recipe
    if (said.base or recipe.name, said.toml, said.parameters, said.template_csv) == (recipe.name, None, None, None):
        return recipe
    return (await candidate_of(context, said.base or recipe.name, said)).recipe


def vision_arguments(context: ApiContext, recipe: Recipe, *, everywhere: bool) -> dict[str, object]:
    """Return what the bench needs to run the vision, but for the picture."""
    return {
        "recipe": recipe_document(recipe),
        "calibration": to_document(require_calibration(context.cell.calibration)),
        "area_mm": None if everywhere else context.cell.settings.pick_area.vertices.tolist(),
    }


async def _preview(call: Call[ApiContext]) -> PreviewDocument:
    context, said = call.context, call.body
    assert isinstance(said, PreviewBody)  # noqa: S101 - as the endpoint declares
    recipe = await recipe_of(context, said)
    picture = await chosen_picture(context, said.picture)
    arguments = {
        **picture.arguments,
        **vision_arguments(context, recipe, everywhere=said.everywhere),
        "name": picture.name,
        "free_slots": said.free_slots,
    }
    done = await context.studio.bench.run("preview", arguments, (picture.blob,), timeout_s=PREVIEW_TIMEOUT_S)
    content = done.content
    files = dict(zip(content.pop("buffers"), done.blobs, strict=True))
    name = context.studio.keep(Preview(files))
    return PreviewDocument(
        preview=name,
        picture=picture.name,
        recipe=recipe.name,
        buffers=[
            BufferDocument(
                name=file,
                media_type=BUFFERS[file],
                bytes=len(blob),
                path=f"/v1/vision/previews/{name}/{file}",
            )
            for file, blob in files.items()
        ],
        expires_s=context.studio.previews.kept_s,
        **content,
    )


async def _buffer(call: Call[ApiContext]) -> Response:
    name, file = call.text("preview"), call.text("buffer")
    found = call.context.studio.previews.get(name)
    if found is None or file not in found.files:
        raise ProblemError(404, f"preview {name:.40} has no {file:.40}, or is not kept any more")
    return Response(found.files[file], media_type=BUFFERS[file], headers={"cache-control": "max-age=600, immutable"})


async def _upload(call: Call[ApiContext]) -> PictureDocument:
    pictures = call.context.studio.pictures
    name, width, height = await pictures.upload(call.raw)
    return PictureDocument(picture=name, width=width, height=height, expires_s=pictures.uploads.kept_s)


_TAG = "vision"
ENDPOINTS = (
    Endpoint(
        *("POST", "/v1/vision/preview", "Run the vision on a picture, with parameters that are not active", _preview),
        *(PreviewDocument, _TAG),
        body=PreviewBody,
        body_bytes=CANDIDATE_BYTES,
        problems=(404, 503),
        kept=False,
    ),
    Endpoint(
        *("GET", "/v1/vision/previews/{preview}/{buffer}", f"What a preview passed by: {', '.join(BUFFERS)}", _buffer),
        *("application/octet-stream", _TAG),
        problems=(404,),
    ),
    Endpoint(
        *("POST", "/v1/vision/pictures", "Upload a picture to work on; it is kept for a while", _upload),
        *(PictureDocument, _TAG),
        raw="image/png",
        body_bytes=MAX_UPLOAD_BYTES,
        kept=False,
    ),
)
