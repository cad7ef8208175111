"""What is a template, and how is it said what is wrong with one?  Values only; nothing is read here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from slabcell.errors import TemplateError
from slabcell.geometry import Polygon

__all__ = ["MAX_PROBLEMS", "TEXTS", "Examined", "PointMm", "Problem", "Template", "Value"]

MAX_PROBLEMS: Final = 50
Value: TypeAlias = str | int | float
PointMm: TypeAlias = tuple[float, float]

TEXTS: Final[Mapping[str, str]] = {
    # Of any file
    "too_large": "is larger than {most_mib} MiB, which no template is",
    # Of CSV files
    "not_utf8": "byte {byte} of the line is not UTF-8; save the file as 'CSV UTF-8'",
    "nul": "holds a NUL character, so it is no text file; save it as 'CSV UTF-8'",
    "too_many": "has {count} polygons, the limit is {most}; split the template",
    "not_cells": "cannot be split into cells: {detail}",
    "no_polygon": "holds no polygon; write one a line, as x,y,x,y,... in mm",
    "empty_cell": "the cell is empty; a number is missing",
    "not_a_number": "{cell} is not a number",
    "not_separated": "{cell} is not a number; separate the cells as the file's first line does",
    "number_too_large": "{cell} is too large",
    "odd": "{count} numbers, which is odd: this x has no y",
    # Of polygons, wherever they come from
    "too_few_points": "{count} points; a polygon needs at least 3",
    "too_many_points": "{count} points; the limit is {most}",
    "duplicate_point": (
        "duplicate point ({x:g}, {y:g}), the same as point {first} at {first_place}; leave one of them out"
    ),
    "closing_point": (
        "duplicate point ({x:g}, {y:g}), the same as point {first} at {first_place}; leave the last point out, a"
        " polygon closes by itself"
    ),
    "crossing": "the outline crosses or touches itself; check the order of the points",
    "zero_area": "zero area; the points lie on one line",
    # Of all polygons together
    "in_metres": (
        "all slots together measure {extent_mm:g} mm, less than {least_mm:g} mm: the file is probably in metres; write"
        " millimetres"
    ),
    "in_micrometres": (
        "all slots together measure {extent_mm:g} mm, more than {most_mm:g} mm: the file is probably in micrometres or"
        " pixels; write millimetres"
    ),
    "tiny_slot": (
        "the slot measures {size_mm:g} mm and the whole template {extent_mm:g} mm: probably metres among millimetres"
    ),
    "overlap": "slot {slot} overlaps slot {other} of {other_place} by {area_mm2:.1f} mm²; move them apart",
    # Of DXF drawings
    "dwg": "is a DWG drawing; save it as DXF",
    "binary_dxf": "is a binary DXF drawing; save it as ASCII DXF",
    "not_dxf": "cannot be read as DXF: {detail}; export it again, as DXF of 2000 or later",
    "no_unit": "names no unit ($INSUNITS is {code}); set the unit in the drawing, or say it (--unit mm)",
    "too_many_entities": (
        "has more than {most} entities with its blocks expanded; export only the layers of the slabs, or explode less"
    ),
    "too_deep": "blocks stand in blocks more than {most} deep, or in themselves; explode them in the drawing",
    "bad_entity": "{kind} cannot be read: {detail}; draw it anew as a closed polyline",
    "not_flat": "{kind} is not flat: its height changes by {height_mm:g} mm; draw the slabs in one plane",
    "open_chain": (
        "the outline is open: {gap_mm:.3f} mm are missing at ({x:g}, {y:g}), {most_mm:g} mm are closed by themselves;"
        " close it in the drawing"
    ),
    "branch": "{count} lines meet at ({x:g}, {y:g}): which outline goes on is not sure; draw closed polylines",
    "encloses": (
        "the outline encloses {count} others, and a slab has no hole: it is a frame, or lies on another layer than the"
        " slabs; name the layers of the slabs (--layer)"
    ),
    "no_outline": "holds no closed outline on the layers that are read ({layers}); draw slabs as closed polylines",
    "no_layer": "has no layer {layer}; its layers are {layers}",
    "not_read": "{count} entities are passed over: {kinds}",
    # What the cell would make of them
    "no_grasp": "slot {slot}: {detail}",
    "off_centre": "slot {slot} is gripped {lever_mm:.1f} mm beside its centre of mass: the slab may tilt",
    "alike": "slots {others} have the same outline: either slab is laid in either",
    "confusable": (
        "slots {slot} and {other} differ by {apart_mm:.2f} mm only: slabs that are not told apart by {needed_mm:g} mm"
        " are refused"
    ),
    "turns": "slot {slot} looks the same in {order} rotations: the slab is laid in any of them",
    "gap": "slots {slot} and {other} are {gap_mm:.2f} mm apart: a gap as narrow is often a slip of the drawing",
}
"""What is said in English, by kind; other languages have words for the same kinds and values."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong, or with ``advice`` worth knowing.

    ``place`` is where in the file, as a message has it between file and text.  ``at_mm`` and ``outlines_mm`` are where
    on the pattern, in assembly coordinates, if that is known.
    """

    kind: str
    place: str = ""
    values: Mapping[str, Value] = field(default_factory=dict[str, Value])
    slots: tuple[int, ...] = ()
    at_mm: PointMm | None = None
    outlines_mm: tuple[tuple[PointMm, ...], ...] = ()
    advice: bool = False

    @property
    def text(self) -> str:
        """What it is, in English."""
        return TEXTS[self.kind].format(**self.values)

    @property
    def line(self) -> str:
        """Place and text, as they stand behind the name of a file."""
        return f"{self.place}: {self.text}"


@dataclass(frozen=True)
class Template:
    """The polygons to be laid, in assembly coordinates (mm); a slot is known by its index, counted from 0.

    ``names`` are what people call the slots, empty where a slot has none.
    """

    name: str
    slots: tuple[Polygon, ...]
    sha256: str
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Examined:
    """What a file holds, even if something is wrong: every outline that could be read, and every problem.

    ``names`` has one entry for each outline.  ``sha256`` is that of the file.
    """

    slots: tuple[Polygon, ...]
    names: tuple[str, ...]
    problems: tuple[Problem, ...]
    sha256: str

    def require(self, source: str, name: str) -> Template:
        """Return the template.  Raises TemplateError that lists every problem, with ``source`` before each."""
        faults = [f"{source}{item.line}" for item in self.problems if not item.advice]
        if faults:
            more = [f"... and {len(faults) - MAX_PROBLEMS} more"] if len(faults) > MAX_PROBLEMS else []
            raise TemplateError("\n".join(faults[:MAX_PROBLEMS] + more), problems=tuple(faults))
        return Template(name, self.slots, self.sha256, self.names)
