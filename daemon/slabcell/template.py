"""Which polygons are to be laid?  Reads a template: a CSV file with one polygon a line, ``x,y,x,y,…`` in mm.

The file is what spreadsheets write: UTF-8 with or without BOM; comma, semicolon or tab between cells (with semicolon
or tab the decimal sign may be a comma); blank lines, lines that begin with ``#`` and empty cells at a line's end are
passed over.  Everything that is wrong is reported at once, with file, line and column (the cell, counted as a
spreadsheet counts it).
"""

import csv
import hashlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely

from slabcell.errors import TemplateError
from slabcell.geometry import Points, Polygon

__all__ = ["Template", "load_template", "parse_template"]

MAX_BYTES = 8 << 20
MAX_SLOTS = 5_000
MAX_POINTS = 2_000
MAX_PROBLEMS = 50

# Slabs are between a fingernail and a lorry: outside of this the unit is probably wrong.
SMALLEST_EXTENT_MM = 5.0
LARGEST_EXTENT_MM = 50_000.0

# Coordinates written with two decimals let neighbours overlap by slivers of this width; it is not an overlap.
SLIVER_MM = 0.05

_LINE_END = re.compile(r"\r\n|\r|\n")
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Template:
    """The polygons to be laid, in assembly coordinates (mm); a slot is known by its index, counted from 0."""

    name: str
    slots: tuple[Polygon, ...]
    sha256: str


@dataclass(frozen=True)
class _Row:
    line: int
    cells: list[str]


def load_template(path: Path) -> Template:
    """Return the checked template of a CSV file.  Raises TemplateError that lists every problem."""
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise TemplateError(msg) from error
    return parse_template(raw, str(path), name=path.stem)


def parse_template(raw: bytes, source: str, *, name: str = "template") -> Template:
    """Return the checked template of a file's bytes; ``source`` stands in messages.  Raises TemplateError."""
    if len(raw) > MAX_BYTES:
        msg = f"{source}: is larger than {MAX_BYTES >> 20} MiB, which no template is"
        raise TemplateError(msg)
    separator, rows = _rows(_decode(raw, source), source)
    problems: list[str] = []
    slots: list[tuple[int, Polygon]] = []
    for row in rows:
        found = list(_check_row(row, decimal_comma=separator != ","))
        polygon = next((item for item in found if isinstance(item, Polygon)), None)
        problems += [f"{source}:{row.line}: {item}" for item in found if isinstance(item, str)]
        if polygon is not None:
            slots.append((row.line, polygon))
    if not rows:
        problems.append(f"{source}: holds no polygon; write one a line, as x,y,x,y,... in mm")
    if not problems:
        problems += [f"{source}{text}" for text in _check_together(slots)]
    if problems:
        more = [f"... and {len(problems) - MAX_PROBLEMS} more"] if len(problems) > MAX_PROBLEMS else []
        raise TemplateError("\n".join(problems[:MAX_PROBLEMS] + more), problems=tuple(problems))
    return Template(name, tuple(polygon for _, polygon in slots), hashlib.sha256(raw).hexdigest())


def _decode(raw: bytes, source: str) -> str:
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        msg = f"{source}:{line}: byte {column} of the line is not UTF-8; save the file as 'CSV UTF-8'"
        raise TemplateError(msg) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        msg = f"{source}:{line}: holds a NUL character, so it is no text file; save it as 'CSV UTF-8'"
        raise TemplateError(msg)
    return text


def _rows(text: str, source: str) -> tuple[str, list[_Row]]:
    """Return the separator of the file and the lines that hold something."""
    lines = [
        (number, line)
        for number, line in enumerate(_LINE_END.split(text), start=1)
        if line.strip(" \t,;\ufeff") and not line.lstrip().startswith("#")
    ]
    if len(lines) > MAX_SLOTS:
        msg = f"{source}: has {len(lines)} polygons, the limit is {MAX_SLOTS}; split the template"
        raise TemplateError(msg)
    separator = next((mark for mark in ";\t" if lines and mark in lines[0][1]), ",")
    rows: list[_Row] = []
    for number, line in lines:
        try:
            cells = next(csv.reader([line], delimiter=separator))
        except csv.Error as error:
            msg = f"{source}:{number}: cannot be split into cells: {error}"
            raise TemplateError(msg) from error
        while cells and not cells[-1].strip():
            cells.pop()
        rows.append(_Row(number, cells))
    return separator, rows


def _check_row(row: _Row, *, decimal_comma: bool) -> Iterator[str | Polygon]:
    """Yield what is wrong with one line, or its polygon."""
    cells = row.cells
    values: list[float] = []
    broken = False
    for column, cell in enumerate(cells, start=1):
        value = _number(cell, decimal_comma=decimal_comma)
        if isinstance(value, str):
            yield f"{_place(column)}: {value}"
            broken = True
        else:
            values.append(value)
    if broken:
        return
    if len(cells) % 2:
        yield f"{_place(len(cells))}: {len(cells)} numbers, which is odd: this x has no y"
        return
    if len(cells) < 6:
        yield f"{_place(len(cells))}: {len(cells) // 2} points; a polygon needs at least 3"
        return
    if len(cells) > 2 * MAX_POINTS:
        yield f"{_place(2 * MAX_POINTS + 1)}: {len(cells) // 2} points; the limit is {MAX_POINTS}"
        return
    yield from _check_polygon(np.array(values).reshape(-1, 2))


def _check_polygon(points: Points) -> Iterator[str | Polygon]:
    seen: dict[tuple[float, float], int] = {}
    duplicate = False
    for index, point in enumerate(points):
        key = (round(float(point[0]), 6), round(float(point[1]), 6))
        if key in seen:
            first = seen[key]
            closing = first == 0 and index == len(points) - 1
            remedy = "leave the last point out, a polygon closes by itself" if closing else "leave one of them out"
            yield (
                f"{_place(2 * index + 1)}: duplicate point ({point[0]:g}, {point[1]:g}), the same as point {first + 1}"
                f" at {_place(2 * first + 1)}; {remedy}"
            )
            duplicate = True
        seen.setdefault(key, index)
    if duplicate:
        return
    ring = shapely.LinearRing(points)
    if not ring.is_simple:
        yield f"{_place(_crossing(points))}: the outline crosses or touches itself; check the order of the points"
        return
    polygon = Polygon.from_points(points)
    longest = max(polygon.bounds[2] - polygon.bounds[0], polygon.bounds[3] - polygon.bounds[1])
    if polygon.area_mm2 <= 1e-6 * longest * longest:
        yield f"{_place(1)}: zero area; the points lie on one line"
        return
    yield polygon


def _crossing(points: Points) -> int:
    """Return the column of the first edge that meets an edge that is not its neighbour."""
    count = len(points)
    edges = [shapely.LineString([points[i], points[(i + 1) % count]]) for i in range(count)]
    tree = shapely.STRtree(edges)
    for index, edge in enumerate(edges):
        for other in sorted(int(hit) for hit in tree.query(edge, predicate="intersects")):
            if other > index:
                apart = min(other - index, count - other + index)
                overlap = shapely.intersection(edge, edges[other])
                if apart > 1 or overlap.length > 0:
                    return 2 * other + 1
    return 1


def _check_together(slots: list[tuple[int, Polygon]]) -> Iterator[str]:
    low = np.min([polygon.bounds[:2] for _, polygon in slots], axis=0)
    high = np.max([polygon.bounds[2:] for _, polygon in slots], axis=0)
    extent = float(np.max(high - low))
    if extent < SMALLEST_EXTENT_MM:
        yield (
            f": all slots together measure {extent:g} mm, less than {SMALLEST_EXTENT_MM:g} mm:"
            " the file is probably in metres; write millimetres"
        )
        return
    if extent > LARGEST_EXTENT_MM:
        yield (
            f": all slots together measure {extent:g} mm, more than {LARGEST_EXTENT_MM:g} mm:"
            " the file is probably in micrometres or pixels; write millimetres"
        )
        return
    for line, polygon in slots:
        size = max(polygon.bounds[2] - polygon.bounds[0], polygon.bounds[3] - polygon.bounds[1])
        if size < 1e-3 * extent:
            yield (
                f":{line}: {_place(1)}: the slot measures {size:g} mm and the whole template {extent:g} mm:"
                " probably metres among millimetres"
            )
    shapes = [polygon.shape for _, polygon in slots]
    tree = shapely.STRtree(shapes)
    for index, shape in enumerate(shapes):
        for other in sorted(int(hit) for hit in tree.query(shape, predicate="intersects")):
            if other >= index:
                continue
            common = shapely.intersection(shape, shapes[other])
            if not shapely.buffer(common, -SLIVER_MM).is_empty:
                yield (
                    f":{slots[index][0]}: {_place(1)}: slot {index} overlaps slot {other} of line {slots[other][0]}"
                    f" by {common.area:.1f} mm²; move them apart"
                )


def _number(cell: str, *, decimal_comma: bool) -> float | str:
    """Return the number in a cell, or what is wrong with it."""
    text = cell.strip().removeprefix("\ufeff")
    if not text:
        return "the cell is empty; a number is missing"
    plain = text.replace(",", ".") if decimal_comma and text.count(",") == 1 and "." not in text else text
    if not _NUMBER.fullmatch(plain):
        mixed = any(mark in text for mark in ",;\t")
        hint = "; separate the cells as the file's first line does" if mixed else ""
        return f"{text[:40]!r} is not a number{hint}"
    value = float(plain)
    return value if math.isfinite(value) else f"{text[:40]!r} is too large"


def _place(column: int) -> str:
    """Return a column as a person finds it in a text file and in a spreadsheet."""
    letters = ""
    rest = column
    while rest:
        rest, letter = divmod(rest - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return f"column {column} ({letters})"
