"""`slabcell template`: what is wrong with a template, and what does it look like?"""

import json
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
import typer
from rich.console import Console
from rich.table import Table

from slabcell.errors import SlabcellError, TemplateError
from slabcell.geometry import Points
from slabcell.template import Template, load_template

__all__ = ["template_app"]

template_app = typer.Typer(help="Check and draw a template.", no_args_is_help=True)

File = Annotated[Path, typer.Argument(help="CSV file: one polygon a line, x,y,x,y,... in mm")]


@template_app.command()
def check(
    file: File, *, as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False
) -> None:
    """Say what is wrong with a template, with line and column, or list its slots."""
    try:
        template = load_template(file)
    except TemplateError as error:
        if not as_json:
            raise
        typer.echo(json.dumps({"schema": "slabcell.template-check/1", "file": str(file), "problems": error.problems}))
        raise typer.Exit(error.exit_code) from error
    if as_json:
        slots = [
            {
                "slot": index,
                "points": len(slot.vertices),
                "area_mm2": round(slot.area_mm2, 2),
                "centroid_mm": [round(float(value), 3) for value in slot.centroid],
            }
            for index, slot in enumerate(template.slots)
        ]
        document = {"schema": "slabcell.template-check/1", "file": str(file), "problems": [], "slots": slots}
        typer.echo(json.dumps(document))
        return
    table = Table("Slot", "Points", "Area mm²", "Width mm", "Height mm", title=f"{file}: {len(template.slots)} slots")
    for index, slot in enumerate(template.slots):
        x0, y0, x1, y1 = slot.bounds
        table.add_row(str(index), str(len(slot.vertices)), f"{slot.area_mm2:.1f}", f"{x1 - x0:.1f}", f"{y1 - y0:.1f}")
    Console().print(table)


@template_app.command()
def show(
    file: File,
    out: Annotated[Path, typer.Option("--out", help="PNG file to write")] = Path("template.png"),
    width: Annotated[int, typer.Option(min=200, max=8000, help="width of the picture in pixels")] = 1200,
) -> None:
    """Draw a template: every slot with its number, and the axes of the assembly."""
    picture = draw(load_template(file), width)
    done, encoded = cv2.imencode(".png", picture)
    if not done:
        msg = f"{out}: the picture could not be encoded"
        raise SlabcellError(msg)
    try:
        out.write_bytes(encoded.tobytes())
    except OSError as error:
        msg = f"{out}: cannot be written: {error.strerror}"
        raise SlabcellError(msg) from error
    typer.echo(str(out))


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
