"""`slabcell locate`: which slabs lie on these pictures, where, and which slot is each for?

Exit code 0: every picture was looked at, whatever was found on it.  Otherwise the code of the first picture that could
not be used (1 for a file that is no complete picture, 78 for one of another camera); the others are still done.
"""

import csv
import io
import json
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy.typing as npt
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from slabcell.calibration import load_calibration
from slabcell.errors import CalibrationError, ImageError, SlabcellError, UsageError
from slabcell.images import encode_image, read_image
from slabcell.recipe import Recipe, load_recipe
from slabcell.vision.layers import LayeredLocator
from slabcell.vision.overlay import draw_overlay
from slabcell.vision.result import LocateResult

__all__ = ["locate_command"]

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
# From so many pictures on, starting processes costs less than it saves.
PARALLEL_FROM = 8
CSV_HEAD = (
    "image,slot,pick_x_mm,pick_y_mm,pick_a_deg,place_x_mm,place_y_mm,place_a_deg,thickness_mm,score,"
    "sigma_x_mm,sigma_y_mm,sigma_a_deg"
)


@dataclass(frozen=True)
class _Job:
    """What every picture is located with, and where its overlay goes."""

    calibration: Path
    recipe: Path
    overlay: Path | None
    overlay_is_file: bool

    @cached_property
    def locator(self) -> LayeredLocator:
        """Calibration and recipe, read once in each process."""
        locator = LayeredLocator(load_calibration(self.calibration), load_recipe(self.recipe))
        locator.calibration.require_plane()
        return locator


@dataclass(frozen=True, slots=True, eq=False)
class _Located:
    """A picture's file, and its result or why there is none."""

    path: Path
    result: LocateResult | None
    problem: str = ""
    exit_code: int = 0


def locate_command(
    images: Annotated[
        list[Path], typer.Argument(metavar="IMAGE...", help="PNG, JPEG or TIFF pictures, or directories of them.")
    ],
    calibration: Annotated[
        Path,
        typer.Option("--calibration", metavar="FILE", help="What `slabcell calibrate` wrote: lens and table plane."),
    ],
    recipe: Annotated[Path, typer.Option("--recipe", metavar="FILE", help="Recipe: template, thickness, parameters.")],
    overlay: Annotated[
        Path | None,
        typer.Option(
            "--overlay",
            metavar="OUT",
            help="Draw the result into OUT.png, or for several pictures into the directory OUT.",
        ),
    ] = None,
    poses_csv: Annotated[
        Path | None, typer.Option("--poses-csv", metavar="OUT.csv", help="Write the pick and place poses as a table.")
    ] = None,
    *,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object; of several pictures one on each line.")
    ] = False,
) -> None:
    """Find the slabs on image files, and the slot of each."""
    paths = _expand(images)
    single = len(paths) == 1 and overlay is not None and overlay.suffix.lower() in SUFFIXES
    if overlay is not None and not single and overlay.suffix.lower() in SUFFIXES:
        msg = f"--overlay {overlay} is one file, but there are {len(paths)} pictures: name a directory"
        raise UsageError(msg)
    job = _Job(calibration, recipe, overlay, single)
    console = Console()
    rows: list[tuple[object, ...]] = []
    results: list[_Located] = []
    for located in _run(job, paths):
        results.append(located)
        if located.result is None:
            typer.echo(f"slabcell: error: {located.problem}", err=True)
            continue
        if as_json:
            document = located.result.to_document(str(located.path))
            typer.echo(json.dumps(document, indent=None if len(paths) > 1 else 1, ensure_ascii=False))
        else:
            _print(console, located.path, located.result)
        rows += _pose_rows(located.path, located.result, job.locator.recipe)
    if poses_csv is not None:
        text = io.StringIO()
        text.write(CSV_HEAD + "\n")
        csv.writer(text, lineterminator="\n").writerows(rows)
        _write(poses_csv, text.getvalue().encode("utf-8"))
    if len(paths) > 1 and not as_json:
        _print_summary(console, results)
    codes = [located.exit_code for located in results if located.exit_code]
    if codes:
        raise typer.Exit(codes[0])


def _run(job: _Job, paths: list[Path]) -> Iterator[_Located]:
    """Yield the results in the order of the pictures; many pictures are done on all cores, with a progress bar."""
    cores = os.cpu_count() or 1
    # A promptable model uses all cores for one picture, and one of it in memory is enough.
    if len(paths) < PARALLEL_FROM or cores == 1 or job.locator.layers[0].locator.segmenter is not None:
        yield from (_locate(job, path) for path in paths)
        return
    # Spawned, not forked: OpenCV's threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    bar = Progress(
        TextColumn("locating"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    with ProcessPoolExecutor(min(cores, len(paths)), context, _begin_worker) as pool, bar:
        yield from bar.track(pool.map(partial(_locate, job), paths), total=len(paths))


def _begin_worker() -> None:
    """Leave the other cores to the other processes."""
    cv2.setNumThreads(1)


def _expand(images: Sequence[Path]) -> list[Path]:
    """Return the files, with directories replaced by the pictures in them, in the order of their names."""
    paths: list[Path] = []
    for path in images:
        if path.is_dir():
            inside = sorted(item for item in path.iterdir() if item.suffix.lower() in SUFFIXES)
            if not inside:
                msg = f"{path}: holds no picture ({', '.join(SUFFIXES)})"
                raise UsageError(msg)
            paths += inside
        else:
            paths.append(path)
    return paths


def _locate(job: _Job, path: Path) -> _Located:
    try:
        image = read_image(path)
        job.locator.calibration.require_size(image.shape[1], image.shape[0], str(path))
        result = job.locator.locate(image)
    except (ImageError, CalibrationError) as error:
        text = str(error)
        return _Located(path, None, text if str(path) in text else f"{path}: {text}", error.exit_code)
    if job.overlay is not None:
        target = job.overlay if job.overlay_is_file else job.overlay / f"{path.stem}.overlay.png"
        _write_overlay(target, image, result)
    return _Located(path, result)


def _print_summary(console: Console, results: Sequence[_Located]) -> None:
    usable = [item.result for item in results if item.result is not None]
    parts = sum(len(result.parts) for result in usable)
    refused = sum(len(result.rejected) for result in usable)
    times = sorted(result.timing_ms.get("total", 0.0) for result in usable)
    middle = f", median {times[len(times) // 2]:.1f} ms a picture" if times else ""
    unusable = len(results) - len(usable)
    console.print(
        f"{len(results)} pictures: {parts} slabs located, {refused} blobs refused, {unusable} pictures unusable{middle}"
    )


def _print(console: Console, path: Path, result: LocateResult) -> None:
    table = Table(
        "Slot",
        "Score",
        "Off mm",
        "Pick x, y mm, a °",
        "Place x, y mm",
        "± mm, °",
        title=f"{escape(str(path))}: {len(result.parts)} located, {len(result.rejected)} refused,"
        f" {len(result.empty_slots)} slots without a slab, {result.timing_ms.get('total', 0.0):.1f} ms",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for column in table.columns:
        column.justify = "right"
        column.no_wrap = True
    for part in result.parts:
        alike = f" /{part.symmetry_order}" if part.symmetry_order > 1 else ""
        table.add_row(
            f"{part.slot}{alike}",
            f"{part.score:.3f}",
            f"{part.residual_mm:.3f}",
            f"{part.pick.x_mm:.2f} {part.pick.y_mm:8.2f} {part.pick.a_deg:8.3f}",
            f"{part.place.x_mm:.2f} {part.place.y_mm:8.2f}",
            f"{max(part.sigma.x_mm, part.sigma.y_mm):.3f} {part.sigma.a_deg:.3f}",
        )
    console.print(table)
    console.print(f"Segmentation: {escape(result.segmentation)}")
    for blob in result.rejected:
        console.print(f"Refused at ({blob.u:.0f}, {blob.v:.0f}) px, {blob.reason.value}: {escape(blob.detail)}")
    if any(part.symmetry_order > 1 for part in result.parts):
        console.print("Slot /n: n rotations of the slab look alike.")
    if result.empty_slots:
        console.print(f"Slots without a slab: {', '.join(str(slot) for slot in result.empty_slots)}")


def _pose_rows(path: Path, result: LocateResult, recipe: Recipe) -> list[tuple[object, ...]]:
    return [
        (
            str(path),
            part.slot,
            *(f"{value:.4f}" for value in (part.pick.x_mm, part.pick.y_mm, part.pick.a_deg)),
            *(f"{value:.4f}" for value in (part.place.x_mm, part.place.y_mm, part.place.a_deg)),
            f"{recipe.height_mm(part.slot):g}",
            f"{part.score:.4f}",
            *(f"{value:.5f}" for value in (part.sigma.x_mm, part.sigma.y_mm, part.sigma.a_deg)),
        )
        for part in result.parts
    ]


def _write_overlay(path: Path, image: npt.NDArray[Any], result: LocateResult) -> None:
    _write(path, encode_image(draw_overlay(image, result), str(path), path.suffix.lower()))


def _write(path: Path, content: bytes) -> None:
    """Write a file in one step, so that nobody reads half of it."""
    temporary = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror}"
        raise SlabcellError(msg) from error
