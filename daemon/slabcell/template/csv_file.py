"""Which polygons are to be laid?  Reads a template: a CSV file with one polygon a line, ``x,y,x,y,…`` in mm.

The file is what spreadsheets write: UTF-8 with or without BOM; comma, semicolon or tab between cells (with semicolon
or tab the decimal sign may be a comma); blank lines, lines that begin with ``#`` and empty cells at a line's end are
passed over; one of the form ``# name: A-12`` names the polygon of the next line for people.  Everything that is wrong
is reported at once, with file, line and column (the cell, counted as a spreadsheet counts it).
"""

from __future__ import annotations

import csv
import hashlib
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from slabcell.errors import TemplateError
from slabcell.geometry import Points, Polygon
from slabcell.template.checks import MAX_POINTS, MAX_SLOTS, check_polygon, check_together
from slabcell.template.model import Examined, Problem, Template

__all__ = ["MAX_BYTES", "MAX_NAME", "examine_csv", "load_template", "parse_template", "read_file", "write_csv"]

MAX_BYTES: Final = 8 << 20
MAX_NAME: Final = 60
DRAWING: Final = ".dxf"

_NAME = re.compile(r"\s*#\s*name:\s*(.*?)\s*")
_LINE_END = re.compile(r"\r\n|\r|\n")
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class _Row:
    line: int
    cells: list[str]
    name: str


class _Unreadable(Exception):  # noqa: N818 - it never leaves this file
    """The file as a whole cannot be read."""

    def __init__(self, kind: str, place: str = "", **values: str | float) -> None:
        super().__init__(kind)
        self.problem = Problem(kind, place, values)


def load_template(path: Path) -> Template:
    """Return the checked template of a CSV file.  Raises TemplateError that lists every problem."""
    if path.suffix.lower() == DRAWING:
        msg = f"{path}: is a drawing; make a template of it: slabcell template import {path.name} --out {path.stem}.csv"
        raise TemplateError(msg)
    return parse_template(read_file(path), str(path), name=path.stem)


def read_file(path: Path) -> bytes:
    """Return the bytes of a file of a template, one more at most than a template may have.  Raises TemplateError."""
    try:
        with path.open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise TemplateError(msg) from error


def parse_template(raw: bytes, source: str, *, name: str = "template") -> Template:
    """Return the checked template of a file's bytes; ``source`` stands in messages.  Raises TemplateError."""
    return examine_csv(raw).require(source, name)


def examine_csv(raw: bytes) -> Examined:
    """Return what a file's bytes hold, and everything that is wrong with it."""
    digest = hashlib.sha256(raw).hexdigest()
    if len(raw) > MAX_BYTES:
        return Examined((), (), (Problem("too_large", "", {"most_mib": MAX_BYTES >> 20}),), digest)
    try:
        separator, rows = _rows(_decode(raw))
    except _Unreadable as error:
        return Examined((), (), (error.problem,), digest)
    if not rows:
        return Examined((), (), (Problem("no_polygon"),), digest)
    problems: list[Problem] = []
    slots: list[Polygon] = []
    kept: list[_Row] = []
    for row in rows:
        found = _check_row(row, decimal_comma=separator != ",")
        if isinstance(found, Polygon):
            slots.append(found)
            kept.append(row)
        else:
            problems += found
    if not problems:
        problems = check_together(
            slots,
            lambda slot: f":{kept[slot].line}: {_place(1)}",
            lambda slot: f"line {kept[slot].line}",
        )
    return Examined(tuple(slots), tuple(row.name for row in kept), tuple(problems), digest)


def write_csv(slots: list[tuple[str, Points]], remarks: list[str]) -> bytes:
    """Return the bytes of a template: the name and the corners, (n, 2) mm, of each slot; remarks stand at its head."""
    lines = [f"# {_one_line(text)}" for text in remarks]
    for name, points in slots:
        if name:
            lines.append(f"# name: {_one_line(name)[:MAX_NAME]}")
        lines.append(",".join(f"{value:.4f}".rstrip("0").rstrip(".") for value in points.ravel()))
    return ("\n".join(lines) + "\n").encode()


def _one_line(text: str) -> str:
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())


def _decode(raw: bytes) -> str:
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        raise _Unreadable("not_utf8", f":{line}", byte=column) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise _Unreadable("nul", f":{line}")
    return text


def _rows(text: str) -> tuple[str, list[_Row]]:
    """Return the separator of the file and the lines that hold something."""
    lines: list[tuple[int, str, str]] = []
    name = ""
    for number, line in enumerate(_LINE_END.split(text), start=1):
        if line.lstrip().startswith("#"):
            named = _NAME.fullmatch(line)
            name = named[1][:MAX_NAME] if named else name
        elif line.strip(" \t,;\ufeff"):
            lines.append((number, line, name))
            name = ""
    if len(lines) > MAX_SLOTS:
        raise _Unreadable("too_many", count=len(lines), most=MAX_SLOTS)
    separator = next((mark for mark in ";\t" if lines and mark in lines[0][1]), ",")
    rows: list[_Row] = []
    for number, line, label in lines:
        try:
            cells = next(csv.reader([line], delimiter=separator))
        except csv.Error as error:
            raise _Unreadable("not_cells", f":{number}", detail=str(error)) from error
        while cells and not cells[-1].strip():
            cells.pop()
        rows.append(_Row(number, cells, label))
    return separator, rows


def _check_row(row: _Row, *, decimal_comma: bool) -> Polygon | list[Problem]:
    """Return the polygon of one line, or what is wrong with it."""
    cells = row.cells
    values: list[float] = []
    problems: list[Problem] = []

    def place(column: int) -> str:
        return f":{row.line}: {_place(column)}"

    for column, cell in enumerate(cells, start=1):
        value = _number(cell, decimal_comma=decimal_comma)
        if isinstance(value, str):
            problems.append(Problem(value, place(column), {"cell": repr(cell.strip().removeprefix("\ufeff")[:40])}))
        else:
            values.append(value)
    if problems:
        return problems
    if len(cells) % 2:
        return [Problem("odd", place(len(cells)), {"count": len(cells)})]
    if len(cells) < 6:
        return [Problem("too_few_points", place(len(cells)), {"count": len(cells) // 2})]
    if len(cells) > 2 * MAX_POINTS:
        return [Problem("too_many_points", place(2 * MAX_POINTS + 1), {"count": len(cells) // 2, "most": MAX_POINTS})]
    return check_polygon(np.array(values).reshape(-1, 2), lambda index: place(2 * index + 1))


def _number(cell: str, *, decimal_comma: bool) -> float | str:
    """Return the number in a cell, or the kind of problem that it is."""
    text = cell.strip().removeprefix("\ufeff")
    if not text:
        return "empty_cell"
    plain = text.replace(",", ".") if decimal_comma and text.count(",") == 1 and "." not in text else text
    if not _NUMBER.fullmatch(plain):
        return "not_separated" if any(mark in text for mark in ",;\t") else "not_a_number"
    value = float(plain)
    return value if math.isfinite(value) else "number_too_large"


def _place(column: int) -> str:
    """Return a column as a person finds it in a text file and in a spreadsheet."""
    letters = ""
    rest = column
    while rest:
        rest, letter = divmod(rest - 1, 26)
        letters = chr(ord("A") + letter) + letters
    return f"column {column} ({letters})"
