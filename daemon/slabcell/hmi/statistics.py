"""How well are slabs laid, and does it drift?  Mean, spread, control limits and capability of one kind of deviation.

Individuals chart with moving ranges: sigma within is the mean moving range over d2 = 1.128, control limits are three of
it from the mean; Cp and Cpk are of sigma within, Pp and Ppk of the overall one.  Sources: ISO 7870-2 (individuals
chart), ISO 22514-2 (capability and performance).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

__all__ = ["Bin", "Chart", "Statistics", "chart", "statistics"]

D2: Final = 1.128
MIN_VALUES: Final = 8
"""With fewer values no capability is said."""
BINS: Final = 21
WIDTH: Final = 600.0
HEIGHT: Final = 100.0


@dataclass(frozen=True, slots=True)
class Statistics:
    """Of some values, in their unit; None where there are too few of them."""

    count: int
    mean: float
    deviation: float
    lower: float
    """Lower control limit."""
    upper: float
    cp: float | None
    cpk: float | None
    pp: float | None
    ppk: float | None
    outside: int
    """Values beyond the tolerance."""


@dataclass(frozen=True, slots=True)
class Bin:
    """One bar of a histogram: left edge, width and height in percent."""

    left: float
    width: float
    height: float
    outside: bool


@dataclass(frozen=True, slots=True)
class Chart:
    """What is drawn of some values: points in order, lines by height, bars; 0 is the top, 100 the bottom."""

    points: str
    beyond: tuple[tuple[float, float], ...]
    """Points outside of the control limits."""
    mean: float
    lower: float
    upper: float
    low_tolerance: float
    high_tolerance: float
    bins: tuple[Bin, ...]
    reach: float
    """The value at the top edge; minus that is at the bottom edge."""


def statistics(values: Sequence[float], tolerance: float) -> Statistics | None:
    """Return the statistics of values in the order of their time, held against ± tolerance; None without values."""
    count = len(values)
    if not count:
        return None
    mean = math.fsum(values) / count
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (count - 1)) if count > 1 else 0.0
    moving = math.fsum(abs(b - a) for a, b in itertools.pairwise(values)) / max(1, count - 1)
    within = moving / D2
    enough = count >= MIN_VALUES

    def ratios(sigma: float) -> tuple[float | None, float | None]:
        if not enough or sigma <= 0:
            return None, None
        return tolerance / (3 * sigma), (tolerance - abs(mean)) / (3 * sigma)

    return Statistics(
        *(count, mean, deviation, mean - 3 * within, mean + 3 * within),
        *(*ratios(within), *ratios(deviation)),
        sum(abs(value) > tolerance for value in values),
    )


def chart(values: Sequence[float], found: Statistics, tolerance: float) -> Chart:
    """Return the drawing of values in the order of their time."""
    furthest = max(*(abs(value) for value in values), abs(found.lower), abs(found.upper))
    reach = max(furthest * 1.15, tolerance * 0.02)
    if furthest > tolerance / 3:
        reach = max(reach, tolerance * 1.15)

    def height(value: float) -> float:
        return round(HEIGHT / 2 * (1 - value / reach), 2)

    step = WIDTH / max(1, len(values) - 1)
    places = [(round(index * step, 1), height(value)) for index, value in enumerate(values)]
    beyond = tuple(
        place for place, value in zip(places, values, strict=True) if not found.lower <= value <= found.upper
    )
    counts = [0] * BINS
    for value in values:
        counts[min(BINS - 1, max(0, int((value + reach) / (2 * reach) * BINS)))] += 1
    tallest = max(counts)
    width = 100 / BINS
    bins = tuple(
        Bin(
            round(index * width, 2),
            round(width * 0.9, 2),
            round(100 * number / tallest, 1),
            abs(-reach + (index + 0.5) * 2 * reach / BINS) > tolerance,
        )
        for index, number in enumerate(counts)
    )
    return Chart(
        points=" ".join(f"{x},{y}" for x, y in places),
        beyond=beyond,
        mean=height(found.mean),
        lower=height(found.lower),
        upper=height(found.upper),
        low_tolerance=height(-tolerance),
        high_tolerance=height(tolerance),
        bins=bins,
        reach=reach,
    )
