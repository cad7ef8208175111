"""What does a bundle hold?  Reads one back, strictly and within limits: it may come from anybody.

Raises BundleError that names file, member and cause.
"""

import json
import math
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar, cast

from pydantic import ValidationError

from slabcell.calibration.file import from_document as calibration_from_document
from slabcell.calibration.model import Calibration
from slabcell.cell.bundle import SCHEMA
from slabcell.cell.records import Pair
from slabcell.cell.settings import CellSettings
from slabcell.errors import SlabcellError
from slabcell.geometry import Polygon
from slabcell.images import Image, decode_image
from slabcell.recipe import (
    BlobParameters,
    GateParameters,
    GraspParameters,
    MatchingParameters,
    Recipe,
    SegmentationParameters,
)
from slabcell.template import Template
from slabcell_drivers.robot.arm import ArmModel, arm_by_name
from slabcell_drivers.robot.frame import Frame

__all__ = ["Bundle", "BundleError", "read_bundle", "recipe_from_document"]

MAX_JSON_BYTES = 32 << 20
MAX_PICTURE_BYTES = 256 << 20

_T = TypeVar("_T")


class BundleError(SlabcellError):
    """A bundle cannot be read."""


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """One recorded cycle: what went in, and the pairs that came out."""

    path: Path
    version: str
    created: str
    recipe: Recipe
    calibration: Calibration
    settings: CellSettings
    arm: ArmModel
    picture: Image | None
    free_slots: tuple[int, ...]
    laid_slots: tuple[int, ...]
    correction_mm: tuple[float, float]
    verification: bool
    code: int
    pairs: tuple[Pair, ...]


def read_bundle(path: Path) -> Bundle:
    """Return the bundle of a file.  Raises BundleError, CalibrationError or ImageError."""
    try:
        with zipfile.ZipFile(path) as archive:
            manifest = _document(archive, path, "manifest.json", SCHEMA)
            recipe = _document(archive, path, "recipe.json", "slabcell.recipe/1")
            cell = _document(archive, path, "cell.json", "slabcell.cell/1")
            calibration = calibration_from_document(
                json.loads(_member(archive, path, "calibration.json", MAX_JSON_BYTES)), f"{path}: calibration.json"
            )
            picture = None
            if "frame.png" in archive.namelist():
                picture = decode_image(_member(archive, path, "frame.png", MAX_PICTURE_BYTES), f"{path}: frame.png")
    except OSError as error:
        raise BundleError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        raise BundleError(f"{path}: is damaged, or no bundle: {error}") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise BundleError(f"{path}: calibration.json is no JSON: {error}") from error
    settings, arm = _checked(path, "cell.json", lambda: _cell(cell))
    return Bundle(
        path=path,
        version=_checked(
            path, "manifest.json", lambda: str(cast("dict[str, object]", manifest["versions"])["slabcell"])
        ),
        created=str(manifest.get("created", "")),
        recipe=_checked(path, "recipe.json", lambda: recipe_from_document(recipe)),
        calibration=calibration,
        settings=settings,
        arm=arm,
        picture=picture,
        free_slots=_checked(path, "manifest.json", lambda: _integers(manifest["free_slots"])),
        laid_slots=_checked(path, "manifest.json", lambda: _integers(manifest["laid_slots"])),
        correction_mm=_checked(path, "manifest.json", lambda: _two(manifest["correction_mm"])),
        verification=bool(manifest.get("verification")),
        code=_checked(path, "manifest.json", lambda: _integers([manifest["code"]])[0]),
        pairs=_checked(path, "manifest.json", lambda: _pairs(manifest["offers"])),
    )


def _member(archive: zipfile.ZipFile, path: Path, name: str, limit: int) -> bytes:
    """Return a member's bytes, never more than the limit, whatever the directory of the archive claims."""
    if name not in archive.namelist():
        raise BundleError(f"{path}: holds no {name}; it is no bundle, or of another version")
    with archive.open(name) as stream:
        raw = stream.read(limit + 1)
    if len(raw) > limit:
        raise BundleError(f"{path}: {name} is larger than {limit >> 20} MiB")
    return raw


def _document(archive: zipfile.ZipFile, path: Path, name: str, schema: str) -> dict[str, object]:
    raw = _member(archive, path, name, MAX_JSON_BYTES)
    try:
        document: object = json.loads(raw)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise BundleError(f"{path}: {name} is no JSON: {error}") from error
    if not isinstance(document, dict):
        raise BundleError(f"{path}: {name} holds no object")
    known = cast("dict[str, object]", document)
    if known.get("schema") != schema:
        raise BundleError(f"{path}: {name} has the schema {known.get('schema')!r}, this version reads {schema!r}")
    return known


def _checked(path: Path, name: str, read: Callable[[], _T]) -> _T:
    try:
        return read()
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, ValidationError) as error:
        raise BundleError(f"{path}: {name} is damaged: {type(error).__name__}: {error}") from error


def _numbers(value: object, length: int | None = None) -> tuple[float, ...]:
    numbers = tuple(float(cast("float", item)) for item in cast("list[object]", value))
    if (length is not None and len(numbers) != length) or not all(math.isfinite(number) for number in numbers):
        msg = f"{value!r} are not {length or ''} finite numbers"
        raise ValueError(msg)
    return numbers


def _integers(value: object) -> tuple[int, ...]:
    return tuple(int(cast("int", item)) for item in cast("list[object]", value))


def _two(value: object) -> tuple[float, float]:
    x, y = _numbers(value, 2)
    return x, y


def _frame(value: object) -> Frame:
    return Frame(*_numbers(value, 6))


def _polygons(value: object) -> tuple[Polygon, ...]:
    return tuple(
        Polygon.from_points([_numbers(point, 2) for point in cast("list[object]", polygon)])
        for polygon in cast("list[object]", value)
    )


def recipe_from_document(document: dict[str, object]) -> Recipe:
    """Return the recipe of a ``slabcell.recipe/1`` object.  Raises ValueError, KeyError or TypeError."""
    template = cast("dict[str, object]", document["template"])
    return Recipe(
        name=str(document["name"]),
        template=Template(str(template["name"]), _polygons(template["slots"]), str(template["sha256"])),
        thickness_mm=_numbers([document["thickness_mm"]])[0],
        segmentation=SegmentationParameters.model_validate(document["segmentation"]),
        matching=MatchingParameters.model_validate(document["matching"]),
        grasp=GraspParameters.model_validate(document["grasp"]),
        gates=GateParameters.model_validate(document["gates"]),
        # Older bundles are of a time without these.
        blobs=BlobParameters.model_validate(document.get("blobs", {})),
        other_thickness_mm=_other_thickness(document.get("other_thickness_mm", {})),
    )


def _other_thickness(document: object) -> dict[int, float]:
    slots = cast("dict[str, object]", document)
    return dict(zip(map(int, slots), _numbers(list(slots.values())), strict=True))


def _cell(document: dict[str, object]) -> tuple[CellSettings, ArmModel]:
    (area,) = _polygons([document["pick_area"]])
    radius, approach, limit_mm, limit_deg = _numbers(
        [document[key] for key in ("gripper_radius_mm", "approach_mm", "tolerance_mm", "tolerance_deg")]
    )
    settings = CellSettings(
        *(_frame(document["pick_base"]), _frame(document["place_base"]), _frame(document["tool"]), area),
        forbidden=_polygons(document["forbidden"]),
        gripper_radius_mm=radius,
        approach_mm=approach,
        tolerance_mm=limit_mm,
        tolerance_deg=limit_deg,
    )
    return settings, arm_by_name(str(document["arm"]))


def _pairs(offers: object) -> tuple[Pair, ...]:
    return tuple(
        Pair(_integers([item["slot"]])[0], _frame(item["pick"]), _frame(item["place"]), _numbers([item["score"]])[0])
        for item in cast("list[dict[str, object]]", offers)
    )
