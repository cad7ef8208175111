"""Which slabs does a drawing show?  Reads a DXF file into closed outlines in mm, with names and thicknesses.

Closed polylines (bulges are arcs), circles, ellipses and splines are outlines by themselves; lines, arcs and open
curves are joined where their ends meet (`chains`).  Blocks are expanded (`dxf_entities`).  A text or attribute whose
place is inside of an outline names it.  A thickness is that of the entity (group 39), else what the layer's name says,
as in ``SLABS_10MM``.  Layers that are off or frozen, and ``Defpoints``, are passed over.

The file is not trusted: its size, entities, blocks in blocks and points are bounded, and whatever the library that
parses it makes of broken content is a `Problem`.  Source of the format: Autodesk, "DXF Reference".
"""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal

import shapely

from slabcell.geometry import Points, Polygon
from slabcell.template.chains import Chains, join_chains, place_of
from slabcell.template.checks import MAX_SLOTS, check_polygon, check_together
from slabcell.template.csv_file import MAX_BYTES, MAX_NAME, write_csv
from slabcell.template.dxf_entities import Found, Layers, read_entities
from slabcell.template.model import Problem

__all__ = ["UNITS", "Drawing", "DrawingOptions", "DrawnSlot", "Unit", "is_drawing", "read_drawing"]

Unit = Literal["mm", "cm", "dm", "m", "in", "ft"]
UNITS: Final[dict[Unit, float]] = {"mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0, "in": 25.4, "ft": 304.8}
"""Millimetres of each unit that may be chosen."""
_INSUNITS: Final[dict[int, Unit]] = {1: "in", 2: "ft", 4: "mm", 5: "cm", 6: "m", 14: "dm"}


@dataclass(frozen=True, slots=True)
class DrawingOptions:
    """How a drawing is read.

    ``unit`` None: as $INSUNITS says.  ``layers`` of the outlines; empty: all that are shown.  Arcs become chords that
    leave them by ``chord_mm`` at most; ends nearer than ``join_mm`` meet.
    """

    unit: Unit | None = None
    layers: tuple[str, ...] = ()
    chord_mm: float = 0.02
    join_mm: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSlot:
    """One outline: its polygon, what it is called, where it was drawn, and the thickness if the drawing has one."""

    polygon: Polygon
    name: str
    layer: str
    handle: str
    thickness_mm: float | None

    @property
    def points(self) -> Points:
        """Its corners, (n, 2) mm."""
        return self.polygon.vertices


@dataclass(frozen=True, slots=True)
class Drawing:
    """What a drawing shows, in the order of its names if every slot has one of its own, else as it was drawn."""

    slots: tuple[DrawnSlot, ...]
    unit: Unit | None
    problems: tuple[Problem, ...]

    def csv(self, source: str) -> bytes:
        """Return the template as CSV, which names where each slot came from."""
        remarks = [f"From {source}, in {self.unit}; a polygon a line, in mm."]
        return write_csv([(slot.name, slot.points) for slot in self.slots], remarks)

    def recipe_text(self, file: str) -> str:
        """Return how a recipe begins that lays this drawing: the commonest thickness, and slots of another."""
        slots: dict[float | None, list[int]] = {}
        for number, slot in enumerate(self.slots):
            slots.setdefault(slot.thickness_mm, []).append(number)
        known = sorted((len(numbers), thickness) for thickness, numbers in slots.items() if thickness is not None)
        lines = ["[template]", f"file = {json.dumps(file)}"]
        if not known:
            return "\n".join([*lines, "thickness_mm = 10.0     # the drawing says none: measure a slab"])
        usual = known[-1][1]
        lines.append(f"thickness_mm = {usual:g}")
        for thickness, numbers in slots.items():
            if thickness is not None and thickness != usual:
                lines += ["", "[[template.other_thickness]]", f"slots = {numbers}", f"thickness_mm = {thickness:g}"]
        return "\n".join(lines)


def is_drawing(raw: bytes) -> bool:
    """Return whether bytes are probably a DXF or DWG file: what comes over the network has no name to go by."""
    start = raw[:200].removeprefix(b"\xef\xbb\xbf")
    if start.startswith((b"AutoCAD Binary DXF", b"AC10")):
        return True
    return bool(re.match(rb"\s*(999\r?\n[^\n]*\n\s*)*0\r?\n\s*(SECTION|EOF)\b", start))


def read_drawing(raw: bytes, options: DrawingOptions | None = None) -> Drawing:
    """Return what a DXF file shows, and everything that is wrong with it.  Never raises for content."""
    options = options or DrawingOptions()
    refused = _refuse(raw)
    if refused is not None:
        return Drawing((), None, (refused,))
    document = _parse(raw)
    if isinstance(document, Problem):
        return Drawing((), None, (document,))
    code = _integer(document.header.get("$INSUNITS", 0))
    unit = options.unit or _INSUNITS.get(code)
    if unit is None:
        return Drawing((), None, (Problem("no_unit", "", {"code": code}),))
    layers = Layers(document, options.layers)
    if layers.missing:
        known = ", ".join(sorted(layers.known)[:20])
        return Drawing((), unit, (Problem("no_layer", "", {"layer": repr(layers.missing), "layers": known}),))
    found = read_entities(document, UNITS[unit], layers, options.chord_mm)
    return _assemble(found, unit, layers, options)


def _refuse(raw: bytes) -> Problem | None:
    if len(raw) > MAX_BYTES:
        return Problem("too_large", "", {"most_mib": MAX_BYTES >> 20})
    if raw.startswith(b"AutoCAD Binary DXF"):
        return Problem("binary_dxf")
    if raw.startswith(b"AC10"):
        return Problem("dwg")
    if not is_drawing(raw):
        return Problem("not_dxf", "", {"detail": "it does not begin with a section"})
    return None


def _parse(raw: bytes) -> Any:
    """Return the library's document, or the problem that it has with it."""
    with _no_fonts():
        from ezdxf import filemanagement  # noqa: PLC0415 - slow to load, and nobody needs it who has no drawing

    try:
        # Not its recovering reader: the audit that this runs takes time exponential in the depth of blocks.
        document = filemanagement.read(io.StringIO(_decode(raw)))
    except RecursionError:
        return Problem("not_dxf", "", {"detail": "it is nested too deep"})
    except Exception as error:  # noqa: BLE001 - a parser of content that anybody may have made: whatever it raises
        detail = " ".join(str(error).split())[:100] or type(error).__name__
        return Problem("not_dxf", "", {"detail": detail.replace("{", "(").replace("}", ")")})
    return document


def _decode(raw: bytes) -> str:
    """Return the text of a file: UTF-8 since DXF of 2007, before that in the code page that it names."""
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        page = re.search(rb"\$DWGCODEPAGE\s+3\s+ANSI_(\d{3,4})\b", raw[:20_000])
        name = f"cp{page[1].decode()}" if page else "cp1252"
        try:
            text = raw.decode(name, errors="replace")
        except LookupError:
            text = raw.decode("cp1252", errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


@contextmanager
def _no_fonts() -> Generator[None]:
    """Keep the library from searching the disk for fonts when it is imported, and from writing a cache at home."""
    known = os.environ.get("XDG_CACHE_HOME")
    with TemporaryDirectory(prefix="slabcell-") as folder:
        cache = Path(folder) / "ezdxf"
        cache.mkdir()
        (cache / "font_manager_cache.json").write_text('{"version": 0, "font-faces": []}', encoding="ascii")
        os.environ["XDG_CACHE_HOME"] = folder
        try:
            yield
        finally:
            if known is None:
                del os.environ["XDG_CACHE_HOME"]
            else:
                os.environ["XDG_CACHE_HOME"] = known


def _assemble(found: Found, unit: Unit, layers: Layers, options: DrawingOptions) -> Drawing:
    """Return the drawing that the chains make."""
    problems = list(found.problems)
    joined: Chains = join_chains(found.chains, options.join_mm)
    problems += joined.problems
    slots: list[DrawnSlot] = []
    if len(joined.closed) > MAX_SLOTS:
        return Drawing((), unit, (Problem("too_many", "", {"count": len(joined.closed), "most": MAX_SLOTS}),))
    for chain in joined.closed:
        place = place_of(chain.handle, chain.layer)
        checked = check_polygon(chain.points, lambda index, place=place: f"{place}: point {index + 1}")
        if isinstance(checked, Polygon):
            slots.append(DrawnSlot(checked, "", chain.layer, chain.handle, chain.thickness_mm))
        else:
            problems += checked
    slots = _in_order(_named(slots, found.texts))
    if found.passed_over:
        kinds = ", ".join(f"{kind} ({count})" for kind, count in sorted(found.passed_over.items())[:8])
        values = {"count": found.passed_over.total(), "kinds": kinds}
        problems.append(Problem("not_read", "", values, advice=True))
    if not slots:
        faults = [item for item in problems if not item.advice]
        return Drawing((), unit, tuple(faults or [Problem("no_outline", "", {"layers": layers.said})]))
    frames = _frames(slots)
    problems += frames
    if not frames:
        problems += check_together(
            [slot.polygon for slot in slots],
            lambda index: place_of(slots[index].handle, slots[index].layer),
            lambda index: place_of(slots[index].handle, slots[index].layer).removeprefix(": "),
        )
    return Drawing(tuple(slots), unit, tuple(problems))


def _named(slots: list[DrawnSlot], texts: list[tuple[float, float, str]]) -> list[DrawnSlot]:
    """Return the slots with the texts inside of them as names; several are read one after the other."""
    if not slots or not texts:
        return slots
    tree = shapely.STRtree([slot.polygon.shape for slot in slots])
    words: dict[int, list[str]] = {}
    for x, y, text in texts:
        for hit in tree.query(shapely.Point(x, y), predicate="intersects"):
            words.setdefault(int(hit), []).append(text)
    return [
        DrawnSlot(
            *(slot.polygon, " ".join(words.get(index, []))[:MAX_NAME]),
            *(slot.layer, slot.handle, slot.thickness_mm),
        )
        for index, slot in enumerate(slots)
    ]


def _in_order(slots: list[DrawnSlot]) -> list[DrawnSlot]:
    names = {slot.name for slot in slots}
    if "" in names or len(names) < len(slots):
        return slots
    return sorted(slots, key=lambda slot: _natural(slot.name))


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which A2 comes before A10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(part), "") if part[0].isascii() and part[0].isdigit() else (1, 0, part) for part in parts]


def _frames(slots: list[DrawnSlot]) -> list[Problem]:
    """Return outlines that lie around others: title blocks, holes."""
    shapes = [slot.polygon.shape for slot in slots]
    tree = shapely.STRtree(shapes)
    found: list[Problem] = []
    for index, shape in enumerate(shapes):
        inside = [int(hit) for hit in tree.query(shape, predicate="contains_properly")]
        others = [hit for hit in inside if hit != index]
        if others:
            place = place_of(slots[index].handle, slots[index].layer)
            outline = tuple((float(x), float(y)) for x, y in slots[index].points)
            values = {"count": len(others)}
            found.append(Problem("encloses", place, values, (index,), outline[0], (outline,)))
    return found


def _integer(value: Any) -> int:
    try:
        return int(value)
    except (TypeError, ValueError, OverflowError):
        return 0
