"""What do the lines of a CSV file say?  Bounded reading of small tables with a header.

Errors name file, line and column.

UTF-8 with or without BOM; comma, semicolon or tab; blank lines and lines that begin with # are left out.
"""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slabcell.errors import CalibrationError

__all__ = ["Row", "read_rows", "rows_of"]

MAX_BYTES = 1 << 20
MAX_ROWS = 10_000


@dataclass(frozen=True, slots=True)
class Row:
    """One line: its values by column, and where it stands."""

    where: str
    values: dict[str, str]

    def text(self, column: str) -> str:
        """Return a value as it is written, without surrounding blanks; empty if there is no such column."""
        return self.values.get(column, "")

    def number(self, column: str, limit: float) -> float:
        """Return a value that is a number within ±limit.  Raises CalibrationError."""
        text = self.values[column]
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not abs(value) <= limit:
            raise CalibrationError(f"{self.where}: {column} = {text[:40]!r} is not a number within ±{limit:g}")
        return value

    def count(self, column: str, limit: int) -> int:
        """Return a value that is a whole number from 0 to limit.  Raises CalibrationError."""
        value = self.number(column, float(limit))
        if value < 0 or value != int(value):
            raise CalibrationError(
                f"{self.where}: {column} = {self.values[column][:40]!r} is not a whole number from 0"
            )
        return int(value)


def read_rows(path: Path, *headers: str) -> tuple[str, list[Row]]:
    """Return which of the ``headers`` (as ``"u,v,x,y"``) the file has, and its rows.

    Case, blanks and the endings _mm, _px and _deg of a column's name do not matter.  Raises CalibrationError.
    """
    return rows_of(_content(path), str(path), *headers)


def rows_of(raw: bytes, path: str, *headers: str) -> tuple[str, list[Row]]:
    """Return the same of a table that is not a file; ``path`` is what it is called.  Raises CalibrationError."""
    numbered = _lines(raw, path)
    delimiter = max(",;\t", key=numbered[0][1].count)
    try:
        cells = [next(csv.reader(io.StringIO(line), delimiter=delimiter, strict=True)) for _, line in numbered]
    except csv.Error as error:
        raise CalibrationError(f"{path}: is not CSV: {error}") from error
    columns = [_plain(name) for name in cells[0]]
    header = next((h for h in headers if [_plain(name) for name in h.split(",")] == columns), None)
    if header is None:
        raise CalibrationError(f"{path}: the header is {','.join(cells[0])[:200]!r}; it must be {' or '.join(headers)}")
    names = header.split(",")
    rows: list[Row] = []
    for (number, _), values in zip(numbered[1:], cells[1:], strict=True):
        where = f"{path}: line {number}"
        if len(values) != len(names):
            raise CalibrationError(f"{where} has {len(values)} values, the header {len(names)}")
        rows.append(Row(where, dict(zip(names, (v.strip() for v in values), strict=True))))
    return header, rows


def _plain(name: str) -> str:
    plain = name.strip().lower()
    for ending in ("_mm", "_px", "_deg"):
        plain = plain.removesuffix(ending)
    return plain


def _content(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error


def _lines(raw: bytes, path: str) -> list[tuple[int, str]]:
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from error
    if len(raw) > MAX_BYTES:
        raise CalibrationError(f"{path}: is larger than {MAX_BYTES} bytes, which no such list is")
    lines = [
        (n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")
    ]
    if not 2 <= len(lines) <= MAX_ROWS + 1:
        raise CalibrationError(
            f"{path}: holds {len(lines)} lines; a header and 1 to {MAX_ROWS} lines below it are needed"
        )
    return lines
