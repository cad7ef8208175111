"""How long did each stage of a cycle take?  As a bar of its stages, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = ["StageBar", "stage_bars"]


@dataclass(frozen=True, slots=True)
class StageBar:
    """One stage of a cycle in the bar of its times: left edge and width in percent of the whole."""

    name: str
    ms: float
    left: float
    width: float


def stage_bars(times_ms: Mapping[str, float]) -> list[StageBar]:
    """Return the stages of a cycle side by side; ``total`` is left out."""
    stages = [(name, ms) for name, ms in times_ms.items() if name != "total"]
    whole = sum(ms for _, ms in stages) or 1.0
    bars: list[StageBar] = []
    left = 0.0
    for name, ms in stages:
        width = 100 * ms / whole
        bars.append(StageBar(name, ms, round(left, 2), round(width, 2)))
        left += width
    return bars
