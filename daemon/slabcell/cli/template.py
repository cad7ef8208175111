"""`slabcell template`: what is wrong with a template, what does it look like, and how does a drawing become one?"""

import json
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import numpy.typing as npt
import typer
from rich.table import Table

from slabcell.cli.files import write_file
from slabcell.cli.talk import make_console
from slabcell.errors import TemplateError, UsageError
from slabcell.geometry import Points
from slabcell.images import encode_image
from slabcell.template import Examined, Template, examine_csv, read_file
from slabcell.template.dxf import UNITS, Drawing, DrawingOptions, Unit, read_drawing

__all__ = ["template_app"]

template_app = typer.Typer(help="Check and draw a template; make one of a DXF drawing.", no_args_is_help=True)

File = Annotated[Path, typer.Argument(help="CSV file (one polygon a line, x,y,x,y,... in mm) or DXF drawing")]
UnitName = Annotated[
    str | None,
    typer.Option("--unit", help=f"unit of a drawing, {', '.join(UNITS)}; as the drawing says if it is not given"),
]
Layers = Annotated[
    list[str] | None, typer.Option("--layer", help="layer of the slabs in a drawing; repeatable; all that are shown")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]


@template_app.command()
def check(file: File, unit: UnitName = None, layer: Layers = None, *, as_json: AsJson = False) -> None:
    """Say what is wrong with a template, with line and column, or list its slots."""
    try:
        template, drawing = _read(file, _options(unit, layer))
    except TemplateError as error:
        if not as_json:
            raise
        typer.echo(json.dumps({"schema": "slabcell.template-check/1", "file": str(file), "problems": error.problems}))
        raise typer.Exit(error.exit_code) from error
    if as_json:
        typer.echo(json.dumps(_document(file, template, drawing)))
        return
    _print(file, template, drawing)


@template_app.command(name="import")
def import_(
    file: Annotated[Path, typer.Argument(help="DXF drawing")],
    out: Annotated[Path, typer.Option("--out", "-o", help="CSV file to write")],
    unit: UnitName = None,
    layer: Layers = None,
    chord_mm: Annotated[
        float, typer.Option(min=0.001, max=1.0, help="by how much the chords of an arc may leave it")
    ] = DrawingOptions().chord_mm,
    join_mm: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="ends of lines that are nearer meet")
    ] = DrawingOptions().join_mm,
    *,
    as_json: AsJson = False,
) -> None:
    """Make a template of a DXF drawing: its closed outlines, in mm, named by the texts inside of them."""
    options = _options(unit, layer)
    options = DrawingOptions(options.unit, options.layers, chord_mm, join_mm)
    template, drawing = _read(file, options, only_drawing=True)
    assert drawing is not None  # noqa: S101 - as only_drawing asks
    content = drawing.csv(file.name)
    examine_csv(content).require(str(out), out.stem)
    write_file(out, content)
    if as_json:
        typer.echo(json.dumps({**_document(file, template, drawing), "out": str(out)}))
        return
    _print(file, template, drawing)
    thickness = drawing.recipe_text(out.name)
    typer.echo(f"{out} is written; its recipe may begin with\n\n{thickness}")


@template_app.command()
def show(
    file: File,
    out: Annotated[Path, typer.Option("--out", help="PNG file to write")] = Path("template.png"),
    width: Annotated[int, typer.Option(min=200, max=8000, help="width of the picture in pixels")] = 1200,
    unit: UnitName = None,
    layer: Layers = None,
) -> None:
    """Draw a template: every slot with its number, and the axes of the assembly."""
    picture = draw(_read(file, _options(unit, layer))[0], width)
    write_file(out, encode_image(picture, str(out)))
    typer.echo(str(out))


def _options(unit: str | None, layers: list[str] | None) -> DrawingOptions:
    known: dict[str, Unit] = {name: name for name in UNITS}
    if unit is not None and unit not in known:
        msg = f"--unit {unit!r:.20}: choose {', '.join(known)}"
        raise UsageError(msg)
    return DrawingOptions(known[unit] if unit else None, tuple(layers or ()))


def _read(file: Path, options: DrawingOptions, *, only_drawing: bool = False) -> tuple[Template, Drawing | None]:
    """Return the template of a file, and the drawing if it is one.  Raises TemplateError."""
    raw = read_file(file)
    if not only_drawing and file.suffix.lower() != ".dxf":
        return examine_csv(raw).require(str(file), file.stem), None
    drawing = read_drawing(raw, options)
    examined = Examined(
        tuple(slot.polygon for slot in drawing.slots), tuple(slot.name for slot in drawing.slots), drawing.problems, ""
    )
    return examined.require(str(file), file.stem), drawing


def _document(file: Path, template: Template, drawing: Drawing | None) -> dict[str, Any]:
    slots = [
        {
            "slot": index,
            "name": template.names[index],
            "points": len(slot.vertices),
            "area_mm2": round(slot.area_mm2, 2),
            "centroid_mm": [round(float(value), 3) for value in slot.centroid],
        }
        for index, slot in enumerate(template.slots)
    ]
    if drawing is not None:
        for entry, drawn in zip(slots, drawing.slots, strict=True):
            entry |= {"layer": drawn.layer, "entity": drawn.handle, "thickness_mm": drawn.thickness_mm}
    document = {"schema": "slabcell.template-check/1", "file": str(file), "problems": [], "slots": slots}
    return document if drawing is None else {**document, "advice": [item.text for item in drawing.problems]}


def _print(file: Path, template: Template, drawing: Drawing | None) -> None:
    more = [] if drawing is None else ["Layer", "Entity", "Thickness mm"]
    title = f"{file}: {len(template.slots)} slots"
    table = Table("Slot", "Name", "Points", "Area mm²", "Width mm", "Height mm", *more, title=title)
    for index, slot in enumerate(template.slots):
        x0, y0, x1, y1 = slot.bounds
        cells = [str(index), template.names[index], str(len(slot.vertices))]
        cells += [f"{slot.area_mm2:.1f}", f"{x1 - x0:.1f}", f"{y1 - y0:.1f}"]
        if drawing is not None:
            drawn = drawing.slots[index]
            cells += [drawn.layer, drawn.handle, "" if drawn.thickness_mm is None else f"{drawn.thickness_mm:g}"]
        table.add_row(*cells)
    make_console().print(table)
    for item in () if drawing is None else drawing.problems:
        typer.echo(f"{file}: {item.text}")


def draw(template: Template, width_px: int) -> npt.NDArray[np.uint8]:
    """Return a picture of the template, shape (h, w, 3) uint8 BGR, X to the right and Y up."""
    low = np.min([slot.bounds[:2] for slot in template.slots], axis=0)
    high = np.max([slot.bounds[2:] for slot in template.slots], axis=0)
    margin = 0.08 * width_px
    scale = (width_px - 2 * margin) / max(float(high[0] - low[0]), 0.25 * float(high[1] - low[1]))
    height_px = int((high[1] - low[1]) * scale + 2 * margin)
    picture = np.full((height_px, width_px, 3), 255, np.uint8)

    def pixels(points: Points) -> npt.NDArray[np.int32]:
        moved = (points - low) * scale + margin
        moved[..., 1] = height_px - moved[..., 1]
        return np.asarray(np.round(moved * 16), np.int32)

    size = width_px / 1200
    for index, slot in enumerate(template.slots):
        cv2.fillPoly(picture, [pixels(slot.vertices)], (232, 226, 214), cv2.LINE_AA, 4)
        cv2.polylines(picture, [pixels(slot.vertices)], True, (70, 60, 50), max(1, round(2 * size)), cv2.LINE_AA, 4)  # noqa: FBT003 - OpenCV's signature
        u, v = pixels(np.array(slot.shape.representative_point().coords[0])) // 16
        cv2.putText(
            picture, str(index), (int(u) - 8, int(v) + 8), cv2.FONT_HERSHEY_SIMPLEX, 0.9 * size, (20, 20, 20), 2
        )
    origin = pixels(np.zeros(2)) // 16
    for axis, colour, name in (((1.0, 0.0), (0, 0, 200), "X"), ((0.0, 1.0), (0, 140, 0), "Y")):
        tip = (pixels(np.array(axis) * 0.08 * width_px / scale) // 16).tolist()
        cv2.arrowedLine(picture, origin.tolist(), tip, colour, max(1, round(3 * size)), cv2.LINE_AA, 0, 0.2)
        cv2.putText(picture, name, tip, cv2.FONT_HERSHEY_SIMPLEX, 0.7 * size, colour, 2)
    return picture
