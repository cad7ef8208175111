"""What is a product to the cell?  A recipe: its template and the parameters of every stage of the vision.

A recipe is a TOML file.  The smallest is a template and its thickness; every other value has a default that works.
Unknown keys are errors that name the file, the key and the nearest known one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from slabcell.errors import RecipeError
from slabcell.template import Template, load_template
from slabcell.toml_file import TomlTable, read_toml

__all__ = ["GraspParameters", "MatchingParameters", "Recipe", "RecipeFile", "SegmentationParameters", "load_recipe"]


class TemplateReference(TomlTable):
    """``[template]``: the polygons to be laid."""

    file: str = Field(description="CSV file of the template, relative to the recipe")
    thickness_mm: Annotated[float, Field(ge=0, le=500)] = Field(description="thickness of the slabs in mm")


class SegmentationParameters(TomlTable):
    """``[segmentation]``: which pixels belong to slabs."""

    method: Literal["auto", "fixed", "otsu", "local"] = Field(
        default="auto", description="auto chooses between otsu and local and says why"
    )
    polarity: Literal["auto", "light", "dark"] = Field(
        default="auto", description="slabs are lighter or darker than the table"
    )
    threshold: Annotated[int, Field(ge=0, le=65535)] | None = Field(
        default=None, description="grey level between table and slab, for method fixed"
    )
    roi: list[tuple[float, float]] | None = Field(
        default=None, min_length=3, max_length=100, description="region of interest: polygon in image pixels"
    )
    min_area_mm2: Annotated[float, Field(gt=0)] = Field(
        default=25.0, description="smaller blobs are dust and are left out"
    )
    border: Literal["reject", "keep"] = Field(
        default="reject", description="what to do with blobs that touch the picture's rim"
    )


class MatchingParameters(TomlTable):
    """``[matching]``: which blob is which slot."""

    area_tolerance: Annotated[float, Field(gt=0, le=0.5)] = Field(
        default=0.12, description="relative difference of area above which a blob is not compared with a slot"
    )
    max_residual_mm: Annotated[float, Field(gt=0, le=50)] = Field(
        default=0.6, description="root mean square distance between outline and slot above which a blob is refused"
    )
    min_score: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.8, description="score below which a blob is refused"
    )


class GraspParameters(TomlTable):
    """``[grasp]``: where the suction cup may touch the slab."""

    cup_radius_mm: Annotated[float, Field(ge=0, le=500)] = Field(default=4.0, description="radius of the suction cup")
    margin_mm: Annotated[float, Field(ge=0, le=100)] = Field(
        default=1.0, description="distance kept between cup and outline"
    )


class RecipeFile(TomlTable):
    """The recipe as it is written in the file."""

    template: TemplateReference
    segmentation: SegmentationParameters = SegmentationParameters()
    matching: MatchingParameters = MatchingParameters()
    grasp: GraspParameters = GraspParameters()


@dataclass(frozen=True)
class Recipe:
    """A recipe whose template has been read and checked."""

    name: str
    template: Template
    thickness_mm: float
    segmentation: SegmentationParameters
    matching: MatchingParameters
    grasp: GraspParameters

    @classmethod
    def from_template(cls, template: Template, thickness_mm: float) -> Recipe:
        """Return the smallest recipe: this template, and every parameter at its default."""
        return cls(
            template.name,
            template,
            thickness_mm,
            SegmentationParameters(),
            MatchingParameters(),
            GraspParameters(),
        )


def load_recipe(path: Path) -> Recipe:
    """Return the checked recipe of a TOML file.  Raises RecipeError or TemplateError."""
    written = read_toml(path, RecipeFile, RecipeError)
    template = load_template(path.parent / written.template.file)
    return Recipe(
        path.stem, template, written.template.thickness_mm, written.segmentation, written.matching, written.grasp
    )
