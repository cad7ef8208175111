"""Which board is shown to the camera?  `Board.parse` reads how boards are written on the command line.

::

    checkerboard:12x9:25            inner corners in a row x in a column : square in mm
    charuco:12x9:25:18              squares in a row x in a column : square in mm : marker in mm
    charuco:12x9:25:18:4X4_250      ... : dictionary of ArUco markers (default 4X4_250); add :legacy for OpenCV < 4.6
    circles:4x11:20                 asymmetric grid: circles in a row x rows : half the distance in a row, in mm
    circles:4x11:20:14              ... : diameter of a circle in mm, to correct what perspective does to its centre

A board has its own frame: X along the rows, Y along the columns, Z out of the printed face towards the camera, so that
every point of the board has z = 0 and x, y ≥ 0.  Its *points* are numbered row by row from the origin.
"""

from dataclasses import dataclass
from typing import Literal, Self

import cv2
import numpy as np

from slabcell.errors import UsageError
from slabcell.geometry import Points

__all__ = ["Board"]

BoardKind = Literal["checkerboard", "charuco", "circles"]

MAX_COUNT = 200
MAX_PITCH_MM = 1000.0
MIN_PITCH_MM = 0.05
MAX_TEXT = 200
FORMS = (
    "checkerboard:COLUMNSxROWS:SQUARE_MM, charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY],"
    " circles:COLUMNSxROWS:PITCH_MM[:DIAMETER_MM]"
)


@dataclass(frozen=True, slots=True)
class Board:
    """A flat calibration board.

    ``columns`` and ``rows`` count what the board's kind counts: inner corners, squares (ChArUco) or circles.
    """

    kind: BoardKind
    columns: int
    rows: int
    pitch_mm: float
    marker_mm: float = 0.0
    dictionary: str = ""
    legacy: bool = False
    diameter_mm: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the board that ``text`` describes.  Raises UsageError that says what is wrong with it."""
        kind, *fields = text.strip()[: MAX_TEXT + 1].split(":")
        if kind not in ("checkerboard", "charuco", "circles") or len(fields) < 2 or len(text) > MAX_TEXT:
            raise UsageError(f"board {text[:MAX_TEXT]!r} is not one of: {FORMS}")
        low = {"checkerboard": 3, "charuco": 4, "circles": 2}[kind]
        columns, rows = (_count(part, text, low) for part in _pair(fields[0], text))
        pitch_mm = _length(fields[1], text, "the square" if kind != "circles" else "the pitch")
        extra = fields[2:]
        if kind == "checkerboard":
            _require_no_more(extra, text)
            return cls(kind, columns, rows, pitch_mm)
        if kind == "charuco":
            return cls._parse_charuco(text, columns, rows, pitch_mm, extra)
        diameter_mm = _length(extra.pop(0), text, "the circle") if extra else 0.0
        _require_no_more(extra, text)
        if diameter_mm >= 1.41 * pitch_mm:
            raise UsageError(
                f"board {text!r}: circles of {diameter_mm:g} mm touch each other at a pitch of {pitch_mm:g} mm"
            )
        return cls(kind, columns, rows, pitch_mm, diameter_mm=diameter_mm)

    @classmethod
    def _parse_charuco(cls, text: str, columns: int, rows: int, pitch_mm: float, extra: list[str]) -> Self:
        if not extra:
            raise UsageError(f"board {text!r} needs the marker's size: charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM")
        marker_mm = _length(extra.pop(0), text, "the marker")
        if marker_mm >= pitch_mm:
            raise UsageError(
                f"board {text!r}: a marker of {marker_mm:g} mm does not fit into a square of {pitch_mm:g} mm"
            )
        legacy = bool(extra) and extra[-1] == "legacy"
        if legacy:
            extra.pop()
        dictionary = (extra.pop(0) if extra else "4X4_250").upper().removeprefix("DICT_")
        _require_no_more(extra, text)
        known = [name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")]
        if dictionary not in known:
            raise UsageError(f"board {text!r}: unknown dictionary {dictionary!r}; known are {', '.join(sorted(known))}")
        number = int(getattr(cv2.aruco, f"DICT_{dictionary}"))
        markers, needed = len(cv2.aruco.getPredefinedDictionary(number).bytesList), columns * rows // 2
        if needed > markers:
            raise UsageError(
                f"board {text!r} has {needed} markers, dictionary {dictionary} only {markers}; which is it?"
            )
        return cls("charuco", columns, rows, pitch_mm, marker_mm, dictionary, legacy)

    @property
    def grid(self) -> tuple[int, int]:
        """Points in a row, points in a column (of asymmetric circles: circles in a row, rows)."""
        return (self.columns - 1, self.rows - 1) if self.kind == "charuco" else (self.columns, self.rows)

    @property
    def points(self) -> Points:
        """Every point of the board in the board's frame, mm, shape (n, 3), row by row from the origin."""
        columns, rows = self.grid
        j, i = np.divmod(np.arange(columns * rows), columns)
        # Rows of circles are counted downwards by OpenCV, whose boards begin with a row that is not shifted.
        x = 2 * i + (rows - 1 - j) % 2 if self.kind == "circles" else i
        return np.column_stack([x, j, np.zeros(len(i))]) * self.pitch_mm

    @property
    def turns_alike(self) -> bool:
        """Whether the board looks the same after half a turn, so that its origin has to be chosen by convention."""
        if self.kind == "circles":
            return self.rows % 2 == 0
        return self.kind == "checkerboard" and (self.columns + self.rows) % 2 == 0

    def __str__(self) -> str:
        """Return the board as `parse` reads it."""
        parts = [self.kind, f"{self.columns}x{self.rows}", f"{self.pitch_mm:g}"]
        if self.kind == "charuco":
            parts += [f"{self.marker_mm:g}", self.dictionary] + ["legacy"] * self.legacy
        elif self.diameter_mm:
            parts.append(f"{self.diameter_mm:g}")
        return ":".join(parts)


def _pair(field: str, text: str) -> list[str]:
    parts = field.lower().replace("×", "x").split("x")
    if len(parts) != 2:
        raise UsageError(f"board {text!r}: {field!r} is not COLUMNSxROWS, for example 12x9")
    return parts


def _count(field: str, text: str, low: int) -> int:
    count = int(field) if field.isascii() and field.isdigit() and len(field) < 6 else -1
    if not low <= count <= MAX_COUNT:
        raise UsageError(f"board {text!r}: {field!r} is outside {low} to {MAX_COUNT} points")
    return count


def _length(field: str, text: str, what: str) -> float:
    try:
        value = float(field.lower().removesuffix("mm"))
    except ValueError:
        value = np.nan
    if not MIN_PITCH_MM <= value <= MAX_PITCH_MM:
        raise UsageError(f"board {text!r}: {what} of {field!r} is outside {MIN_PITCH_MM:g} mm to {MAX_PITCH_MM:g} mm")
    return value


def _require_no_more(extra: list[str], text: str) -> None:
    if extra:
        raise UsageError(f"board {text!r}: {':'.join(extra)!r} is too much; boards are written {FORMS}")
