"""How are coverage, residuals and movements drawn?  As SVG in pixels of the camera's picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any, Final

__all__ = ["CoverageDrawing", "Mover", "draw_coverage", "draw_moves", "outline"]

ENLARGED: Final = 100
"""A residual of one pixel is drawn as a stroke of so many."""


@dataclass(frozen=True, slots=True)
class CoverageDrawing:
    """What the points of a board covered: empty cells of a grid, each x, y, width, height; residuals as a path."""

    width: int
    height: int
    empty: tuple[tuple[float, float, float, float], ...]
    seen: int
    cells: int
    strokes: str
    percent: float


@dataclass(frozen=True, slots=True)
class Mover:
    """A point of the picture whose place on the table moved: where, by how much, and the radius it is drawn with."""

    u: float
    v: float
    mm: float
    radius: float


def draw_coverage(coverage: dict[str, Any], residuals: Iterable[Sequence[float]] = ()) -> CoverageDrawing:
    """Return the drawing of a coverage object; a residual is u, v and what is left in u and v."""
    counts: list[list[int]] = coverage["counts"]
    width, height = int(coverage["width"]), int(coverage["height"])
    rows, columns = len(counts), len(counts[0])
    across, down = width / columns, height / rows
    empty = tuple(
        (round(column * across - 0.5, 2), round(row * down - 0.5, 2), round(across, 2), round(down, 2))
        for row, line in enumerate(counts)
        for column, count in enumerate(line)
        if count == 0
    )
    strokes = "".join(f"M{u:.0f} {v:.0f}l{ENLARGED * du:.0f} {ENLARGED * dv:.0f}" for u, v, du, dv in residuals)
    cells = rows * columns
    return CoverageDrawing(width, height, empty, cells - len(empty), cells, strokes, 100 * coverage["hull_fraction"])


def draw_moves(moved: Sequence[Sequence[float]], width: int) -> list[Mover]:
    """Return how much each point moved, the largest as a disc that just does not touch the next one."""
    lengths = [hypot(x, y) for _, _, x, y in moved]
    largest = max(lengths, default=0.0) or 1.0
    return [
        Mover(u, v, length, round(width * (0.004 + 0.026 * length / largest), 1))
        for (u, v, _, _), length in zip(moved, lengths, strict=True)
    ]


def outline(points: Iterable[Sequence[float]]) -> str:
    """Return points as SVG has them."""
    return " ".join(f"{u:.1f},{v:.1f}" for u, v in points)
