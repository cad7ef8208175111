"""What is a product to the cell?  A recipe: its template and the parameters of every stage of the vision.

A recipe is a TOML file.  The smallest is a template and its thickness; every other value has a default that works.
Unknown keys are errors that name the file, the key and the nearest known one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from slabcell.errors import RecipeError, TemplateError
from slabcell.template import Template, load_template
from slabcell.toml_file import TomlTable, read_toml

__all__ = [
    "BlobFeature",
    "BlobFilter",
    "BlobParameters",
    "ForbiddenZone",
    "GateParameters",
    "GraspParameters",
    "Mark",
    "MatchingParameters",
    "MorphologyStep",
    "OtherThickness",
    "PromptableParameters",
    "Recipe",
    "RecipeFile",
    "SegmentationParameters",
    "load_recipe",
    "make_recipe",
]


Thickness = Annotated[float, Field(ge=0, le=500)]


class OtherThickness(TomlTable):
    """``[[template.other_thickness]]``: slots whose slabs have another thickness than the rest."""

    slots: list[Annotated[int, Field(ge=0)]] = Field(min_length=1, max_length=5000, description="numbers of the slots")
    thickness_mm: Thickness = Field(description="thickness of their slabs in mm")


class TemplateReference(TomlTable):
    """``[template]``: the polygons to be laid."""

    file: str = Field(description="CSV file of the template, relative to the recipe")
    thickness_mm: Thickness = Field(description="thickness of the slabs in mm")
    other_thickness: list[OtherThickness] = Field(
        default_factory=list[OtherThickness], max_length=20, description="slots whose slabs are thicker or thinner"
    )


Point = tuple[float, float]
Percent = Annotated[float, Field(ge=0, le=100)]


class MorphologyStep(TomlTable):
    """``[[segmentation.morphology]]``: one step on the mask of the slabs."""

    operation: Literal["open", "close", "erode", "dilate", "fill"] = Field(
        description="open takes specks away, close fills cracks, fill fills every hole"
    )
    size_px: Annotated[int, Field(ge=1, le=99)] = Field(
        default=3, description="diameter of the round neighbourhood in pixels; fill does not use it"
    )


class PromptableParameters(TomlTable):
    """``[segmentation.promptable]``: the model of method promptable, and which of its masks count as slabs."""

    encoder: Annotated[str, Field(min_length=1, max_length=4096)] = Field(
        description="ONNX file of the encoder, or of EfficientSAM in one file, relative to the recipe"
    )
    decoder: Annotated[str, Field(min_length=1, max_length=4096)] | None = Field(
        default=None, description="ONNX file of the decoder, relative to the recipe; EfficientSAM in one file has none"
    )
    coarse: Literal["auto", "fixed", "otsu", "dynamic_hard", "dynamic_soft", "local", "multi_otsu", "kmeans"] = Field(
        default="auto", description="method that finds the coarse blobs, whose boxes and middles are the prompts"
    )
    max_prompts: Annotated[int, Field(ge=1, le=500)] = Field(
        default=64, description="prompts of one picture; the largest coarse blobs are asked for first"
    )
    area_tolerance: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.25, description="relative difference of area to every slot above which a mask is no slab"
    )
    inertia_tolerance: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.25,
        description="relative difference of normalised inertia to every slot above which a mask is no slab",
    )
    min_stability: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.85, description="share of a mask that must stay when its threshold is moved by stability_margin"
    )
    stability_margin: Annotated[float, Field(gt=0, le=20)] = Field(
        default=1.0, description="by how much of a logit the threshold is moved to see how firm a mask is"
    )
    max_overlap: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.2,
        description="share of the smaller of two masks above which the one that fits no slot better is left out",
    )
    max_seconds: Annotated[float, Field(gt=0, le=600)] = Field(
        default=30.0, description="time in seconds after which the model is stopped and the picture refused"
    )
    threads: Annotated[int, Field(ge=0, le=256)] = Field(
        default=0, description="threads that the model runs on; 0 is one for each core"
    )


class SegmentationParameters(TomlTable):
    """``[segmentation]``: which pixels belong to slabs."""

    method: Literal[
        "auto", "fixed", "otsu", "dynamic_hard", "dynamic_soft", "local", "multi_otsu", "kmeans", "promptable"
    ] = Field(default="auto", description="auto chooses between otsu and local and says why")
    polarity: Literal["auto", "light", "dark"] = Field(
        default="auto", description="slabs are lighter or darker than the table"
    )
    threshold: Annotated[int, Field(ge=0, le=65535)] | None = Field(
        default=None, description="grey level between table and slab, for method fixed"
    )
    low_tail_percent: Percent = Field(
        default=1.0, description="share of the darkest pixels that dynamic methods leave out of the range"
    )
    high_tail_percent: Percent = Field(
        default=1.0, description="share of the lightest pixels that dynamic methods leave out of the range"
    )
    level_percent: Percent = Field(
        default=50.0, description="where in the range between the tails the dynamic threshold lies"
    )
    softness_percent: Percent = Field(
        default=40.0, description="width, in percent of the range, over which dynamic_soft goes from table to slab"
    )
    classes: Annotated[int, Field(ge=2, le=5)] = Field(
        default=3, description="grey levels or colours that multi_otsu and kmeans tell apart"
    )
    slab_classes: Annotated[int, Field(ge=1, le=4)] = Field(
        default=1, description="how many of the classes of multi_otsu, from the lightest or darkest, are slabs"
    )
    window_px: Annotated[int, Field(ge=0, le=10000)] = Field(
        default=0, description="neighbourhood from which local takes the table's light; 0 chooses it from the picture"
    )
    roi: list[Point] | None = Field(
        default=None, min_length=3, max_length=100, description="region of interest: polygon in image pixels"
    )
    morphology: list[MorphologyStep] = Field(
        default_factory=list[MorphologyStep], max_length=10, description="steps on the mask, in this order"
    )
    min_area_mm2: Annotated[float, Field(gt=0)] = Field(
        default=25.0, description="smaller blobs are dust and are left out"
    )
    border: Literal["reject", "keep"] = Field(
        default="reject", description="what to do with blobs that touch the picture's rim"
    )
    promptable: PromptableParameters | None = Field(default=None, description="the model of method promptable")

    @model_validator(mode="after")
    def _check(self) -> Self:
        coarse = self.method if self.promptable is None else self.promptable.coarse
        if "fixed" in (self.method, coarse) and self.threshold is None:
            msg = "method 'fixed' needs the key 'threshold', a grey level"
            raise ValueError(msg)
        if self.method == "promptable" and self.promptable is None:
            msg = "method 'promptable' needs the table [segmentation.promptable] with the key 'encoder', a model's file"
            raise ValueError(msg)
        if self.low_tail_percent + self.high_tail_percent >= 100:
            msg = "low_tail_percent and high_tail_percent leave no pixel: their sum must be under 100"
            raise ValueError(msg)
        if self.slab_classes >= self.classes:
            msg = f"slab_classes = {self.slab_classes} leaves no class for the table: classes is {self.classes}"
            raise ValueError(msg)
        return self


BlobFeature = Literal[
    "area_mm2",
    "perimeter_mm",
    "x_mm",
    "y_mm",
    "orientation_deg",
    "elongation",
    "inertia",
    "inertia_major_mm4",
    "inertia_minor_mm4",
    "x_min_mm",
    "y_min_mm",
    "x_max_mm",
    "y_max_mm",
    "length_mm",
    "width_mm",
    "rectangularity",
    "roundness",
    "convexity",
    "holes",
    "hole_area_mm2",
    "hu1",
    "hu2",
    "hu3",
    "hu4",
    "hu5",
    "hu6",
    "hu7",
    "u",
    "v",
]
"""What of a blob can be filtered and sorted by."""


class BlobFilter(TomlTable):
    """``[[blobs.filters]]``: a blob outside of these limits is refused before matching."""

    feature: BlobFeature = Field(description="what is looked at")
    min: Annotated[float, Field(allow_inf_nan=False)] | None = Field(
        default=None, description="least value that passes"
    )
    max: Annotated[float, Field(allow_inf_nan=False)] | None = Field(
        default=None, description="greatest value that passes"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.min is None and self.max is None:
            msg = "a filter needs the key 'min', 'max' or both"
            raise ValueError(msg)
        if self.min is not None and self.max is not None and self.min > self.max:
            msg = f"nothing passes a filter from min = {self.min:g} to max = {self.max:g}"
            raise ValueError(msg)
        return self


class BlobParameters(TomlTable):
    """``[blobs]``: which features of blobs are reported, filtered and sorted by."""

    report: bool = Field(default=False, description="measure the features of every blob and add them to the result")
    filters: list[BlobFilter] = Field(
        default_factory=list[BlobFilter], max_length=50, description="limits that a blob must keep, all of them"
    )
    sort_by: BlobFeature | None = Field(
        default=None, description="order of blobs, parts and refused blobs in the result; none: largest first, by slot"
    )
    sort_order: Literal["ascending", "descending"] = Field(default="descending", description="direction of sort_by")

    @property
    def used(self) -> bool:
        """Whether features have to be measured at all."""
        return self.report or bool(self.filters) or self.sort_by is not None


class MatchingParameters(TomlTable):
    """``[matching]``: which blob is which slot."""

    method: Literal["registration", "hu", "polygon"] = Field(
        default="registration",
        description="registration compares whole outlines; hu and polygon compare as the literature does, for study",
    )
    area_tolerance: Annotated[float, Field(gt=0, le=0.5)] = Field(
        default=0.12, description="relative difference of area above which a blob is not compared with a slot"
    )
    max_residual_mm: Annotated[float, Field(gt=0, le=50)] = Field(
        default=0.4, description="root mean square distance between outline and slot above which a blob is refused"
    )
    min_coverage: Annotated[float, Field(ge=0.3, le=1)] = Field(
        default=0.95, description="share of the outline that must be where the slot says, else the blob is refused"
    )
    min_score: Annotated[float, Field(ge=0, le=1)] = Field(
        default=0.8, description="score below which a blob is refused"
    )
    min_lead_mm: Annotated[float, Field(ge=0, le=50)] = Field(
        default=0.05,
        description="root mean square distance by which a slab must fit better than as any other slot or rotation",
    )
    alike_mm: Annotated[float, Field(ge=0, le=50)] = Field(
        default=0.05, description="slots or rotations whose outlines differ by less are the same: either is right"
    )
    split_touching: bool = Field(
        default=True, description="look for the slots' outlines inside of blobs that are larger than every slot"
    )
    max_hu_distance: Annotated[float, Field(gt=0)] = Field(
        default=0.02, description="Euclidean distance of the seven Hu moments, for method hu"
    )
    polygon_epsilon_percent: Annotated[float, Field(ge=0.1, le=10)] = Field(
        default=2.0, description="simplification of outlines in percent of the perimeter, for method polygon"
    )
    max_side_difference_mm: Annotated[float, Field(gt=0)] = Field(
        default=3.0, description="difference of sorted side lengths, for method polygon"
    )
    max_angle_difference_deg: Annotated[float, Field(gt=0, le=180)] = Field(
        default=6.0, description="difference of sorted interior angles, for method polygon"
    )


class ForbiddenZone(TomlTable):
    """``[[grasp.forbidden]]``: where no cup may touch, in the template's coordinates."""

    polygon: list[Point] = Field(min_length=3, max_length=200, description="corners in mm")
    slot: Annotated[int, Field(ge=0)] | None = Field(default=None, description="slot it belongs to; none means every")


class GraspParameters(TomlTable):
    """``[grasp]``: where the suction cups may touch the slab."""

    cup_radius_mm: Annotated[float, Field(ge=0, le=500)] = Field(default=4.0, description="radius of a suction cup")
    margin_mm: Annotated[float, Field(ge=0, le=100)] = Field(
        default=1.0, description="distance kept between cup and outline"
    )
    cups_mm: list[Point] = Field(
        default_factory=lambda: [(0.0, 0.0)],
        min_length=1,
        max_length=32,
        description="centres of the cups in the tool's X and Y, for grippers of several cups",
    )
    forbidden: list[ForbiddenZone] = Field(
        default_factory=list[ForbiddenZone], max_length=100, description="zones that no cup may touch"
    )


class Mark(TomlTable):
    """``[[gates.marks]]``: a round mark on the table that must be seen where it is."""

    x_mm: float = Field(description="centre on the table")
    y_mm: float = Field(description="centre on the table")
    diameter_mm: Annotated[float, Field(gt=0, le=1000)] = Field(description="of the disc")


class GateParameters(TomlTable):
    """``[gates]``: what a picture must be like before anything is located in it."""

    min_brightness_percent: Percent = Field(
        default=2.0, description="grey that the lightest 0.5 % of the pixels must reach, of full scale"
    )
    max_overexposed_percent: Percent = Field(default=60.0, description="share of pixels that may be saturated")
    max_blur_px: Annotated[float, Field(gt=0, le=100)] = Field(
        default=6.0, description="width (standard deviation) of the sharpest edges of the picture"
    )
    rim_mm: list[Point] | None = Field(
        default=None, min_length=3, max_length=100, description="outline on the table, z = 0, whose edge must be seen"
    )
    marks: list[Mark] = Field(default_factory=list[Mark], max_length=50, description="round marks on the table")
    min_reference_percent: Percent = Field(default=60.0, description="share of rim and marks that must be seen")
    max_reference_shift_mm: Annotated[float, Field(gt=0, le=100)] = Field(
        default=1.0, description="how far rim and marks may be from their places before the camera counts as moved"
    )


class RecipeFile(TomlTable):
    """The recipe as it is written in the file."""

    template: TemplateReference
    segmentation: SegmentationParameters = SegmentationParameters()
    blobs: BlobParameters = BlobParameters()
    matching: MatchingParameters = MatchingParameters()
    grasp: GraspParameters = GraspParameters()
    gates: GateParameters = GateParameters()


@dataclass(frozen=True)
class Recipe:
    """A recipe whose template has been read and checked."""

    name: str
    template: Template
    thickness_mm: float
    segmentation: SegmentationParameters
    matching: MatchingParameters
    grasp: GraspParameters
    gates: GateParameters = field(default_factory=GateParameters)
    blobs: BlobParameters = field(default_factory=BlobParameters)
    other_thickness_mm: Mapping[int, float] = field(default_factory=dict[int, float])
    """Of the slots whose slabs are not ``thickness_mm`` thick."""

    def height_mm(self, slot: int) -> float:
        """Return the thickness of the slab of a slot, which is how high its upper face lies."""
        return self.other_thickness_mm.get(slot, self.thickness_mm)

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
            GateParameters(),
        )


def load_recipe(path: Path) -> Recipe:
    """Return the checked recipe of a TOML file.  Raises RecipeError or TemplateError."""
    written = read_toml(path, RecipeFile, RecipeError)
    try:
        template = load_template(path.parent / written.template.file)
    except TemplateError as error:
        # Whose file it is: the fault may be the recipe's, which names another.
        raise TemplateError(f"{error} (template of {path})", problems=error.problems, number=error.number) from error
    return make_recipe(path.stem, written, template, path.parent)


def make_recipe(name: str, written: RecipeFile, template: Template, folder: Path) -> Recipe:
    """Return the recipe that was written so; ``folder`` is what files of models are named relative to.

    Raises RecipeError for a slot that the template does not have.
    """
    segmentation = written.segmentation
    if segmentation.promptable is not None:
        model = segmentation.promptable
        places = {
            "encoder": str(folder / model.encoder),
            "decoder": None if model.decoder is None else str(folder / model.decoder),
        }
        segmentation = segmentation.model_copy(update={"promptable": model.model_copy(update=places)})
    return Recipe(
        name,
        template,
        written.template.thickness_mm,
        segmentation,
        written.matching,
        written.grasp,
        written.gates,
        written.blobs,
        _other_thickness(written.template, template),
    )


def _other_thickness(reference: TemplateReference, template: Template) -> dict[int, float]:
    found: dict[int, float] = {}
    for item in reference.other_thickness:
        for slot in item.slots:
            if slot >= len(template.slots):
                msg = f"template.other_thickness: slot {slot} is none of the template's, 0 to {len(template.slots) - 1}"
                raise RecipeError(msg)
            if slot in found:
                msg = f"template.other_thickness: slot {slot} is named twice"
                raise RecipeError(msg)
            found[slot] = item.thickness_mm
    return {slot: height for slot, height in found.items() if height != reference.thickness_mm}
