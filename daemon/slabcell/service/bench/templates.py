"""What is in a file that somebody wants as a template?  Read on the bench: it may come from anybody."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from slabcell.recipe import Recipe, load_recipe
from slabcell.service.bench.wire import Json, Message
from slabcell.service.bench.work import Work
from slabcell.service.template_advice import advise
from slabcell.template import Examined, Problem, Template, examine_csv
from slabcell.template.dxf import DrawingOptions, is_drawing, read_drawing

__all__ = ["template"]

MOST_FINDINGS = 300


def template(work: Work) -> Message:
    """Return everything about the template in the first blob, a CSV file or a drawing; without a blob, of a recipe.

    ``recipe`` is the file whose parameters say what the gripper and the vision can do.
    """
    said = work.arguments
    recipe = load_recipe(Path(said["recipe"]))
    if not work.blobs:
        shown = recipe.template
        return Message(_document(Examined(shown.slots, shown.names, (), shown.sha256), recipe, b"", None))
    raw = work.blobs[0]
    thickness: list[float | None] | None = None
    csv, notes = raw, ()
    if is_drawing(raw):
        drawing = read_drawing(raw, DrawingOptions(said["unit"], tuple(said["layers"])))
        csv = drawing.csv("a drawing") if drawing.slots else b""
        thickness, notes = [slot.thickness_mm for slot in drawing.slots], drawing.problems
    examined = examine_csv(csv)
    if thickness is not None:  # the drawing's own findings say where it was drawn
        faulty = any(not item.advice for item in notes) or not csv
        examined = replace(examined, problems=notes if faulty else (*examined.problems, *notes))
    return Message(_document(examined, recipe, csv if thickness is not None else b"", thickness))


def _document(examined: Examined, recipe: Recipe, csv: bytes, thickness: list[float | None] | None) -> Json:
    findings = list(examined.problems)
    faulty = any(not item.advice for item in findings)
    if not faulty:
        shown = Template(recipe.template.name, examined.slots, examined.sha256, examined.names)
        findings += advise(replace(recipe, template=shown))
    return {
        "findings": [_finding(item) for item in findings[:MOST_FINDINGS]],
        "slots": [
            {
                "slot": number,
                "name": examined.names[number],
                "outline_mm": slot.vertices.tolist(),
                "area_mm2": round(slot.area_mm2, 3),
                "thickness_mm": thickness[number] if thickness else None,
            }
            for number, slot in enumerate(examined.slots)
        ],
        "csv": csv.decode(),
        "usable": not faulty,
        "sha256": examined.sha256,
    }


def _finding(item: Problem) -> Json:
    return {
        "kind": item.kind,
        "advice": item.advice,
        "place": item.place.removeprefix(":").strip(),
        "text": item.text,
        "values": dict(item.values),
        "slots": list(item.slots),
        "at_mm": item.at_mm,
        "outlines_mm": [list(outline) for outline in item.outlines_mm],
    }
