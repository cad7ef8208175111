"""How is a template drawn with what lies in its slots?  Polygons in the assembly's own millimetres, Y upwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Drawing", "DrawnSlot", "draw_template"]

STATES = ("laid", "under_way", "free", "given_up", "unknown")


@dataclass(frozen=True, slots=True)
class DrawnSlot:
    """One slot: its corners as SVG has them, where its number stands, and how it is."""

    number: int
    state: str
    points: str
    x: float
    y: float
    text: float
    """Height of its number in the drawing, mm: as large as others, but where it would be larger than its slot."""


@dataclass(frozen=True, slots=True)
class Drawing:
    """A template as SVG; lengths in millimetres."""

    view_box: str
    text: float
    hatch: float
    slots: tuple[DrawnSlot, ...]
    label: str


def draw_template(
    polygons: Sequence[Sequence[Sequence[float]]], slots: Mapping[str, Any] | None, label: str
) -> Drawing:
    """Return the drawing; ``slots`` is the job's ``slots`` object, or None where there is no job."""
    state_of = {number: state for state in STATES for number in (slots or {}).get(state, ())}
    xs = [point[0] for polygon in polygons for point in polygon]
    ys = [-point[1] for polygon in polygons for point in polygon]
    left, right, top, bottom = min(xs), max(xs), min(ys), max(ys)
    size = max(right - left, bottom - top)
    margin = size * 0.02
    box = (left - margin, top - margin, right - left + 2 * margin, bottom - top + 2 * margin)
    drawn = [
        DrawnSlot(
            number,
            state_of.get(number, "free"),
            " ".join(f"{x:.2f},{-y:.2f}" for x, y in polygon),
            *_middle(polygon),
            round(max(size / 70, min(size / 14, _span(polygon, 0) / 2.4, _span(polygon, 1) / 1.3)), 2),
        )
        for number, polygon in enumerate(polygons)
    ]
    return Drawing(
        " ".join(f"{value:.2f}" for value in box), round(size / 14, 2), round(size / 30, 2), tuple(drawn), label
    )


def _span(polygon: Sequence[Sequence[float]], axis: int) -> float:
    """Return how wide (0) or high (1) a polygon is."""
    values = [point[axis] for point in polygon]
    return max(values) - min(values)


def _middle(polygon: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Return the centroid of the area, Y downwards as SVG has it."""
    area = x_sum = y_sum = 0.0
    for (x0, y0), (x1, y1) in zip(polygon, [*polygon[1:], polygon[0]], strict=True):
        cross = x0 * y1 - x1 * y0
        area += cross
        x_sum += (x0 + x1) * cross
        y_sum += (y0 + y1) * cross
    if abs(area) < 1e-9:
        return round(polygon[0][0], 2), round(-polygon[0][1], 2)
    return round(x_sum / (3 * area), 2), round(-y_sum / (3 * area), 2)
