"""Which smooth curve goes through given values without overshooting them?  Cubics with limited slopes."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

__all__ = ["MonotoneCurve"]


@dataclass(frozen=True, slots=True)
class MonotoneCurve:
    """A curve through points, rising or falling with them and never beyond them (Fritsch and Carlson, 1980)."""

    places: tuple[float, ...]
    values: tuple[float, ...]
    slopes: tuple[float, ...]

    @classmethod
    def through(cls, places: Sequence[float], values: Sequence[float], *, rests_at_ends: bool) -> "MonotoneCurve":
        """Return the curve through two points or more; ``places`` rise strictly."""
        steps = [b - a for a, b in pairwise(places)]
        rises = [(b - a) / step for (a, b), step in zip(pairwise(values), steps, strict=True)]
        inner = [_slope(rises[k - 1], rises[k], steps[k - 1], steps[k]) for k in range(1, len(rises))]
        first, last = (0.0, 0.0) if rests_at_ends else (rises[0], rises[-1])
        return cls(tuple(places), tuple(values), (first, *inner, last))

    def at(self, place: float) -> float:
        """Return the value at a place; beyond the ends, that of the end."""
        k, u, step = self._within(place)
        a, b = self.values[k], self.values[k + 1]
        return (
            (1.0 + 2.0 * u) * (1.0 - u) ** 2 * a
            + u * u * (3.0 - 2.0 * u) * b
            + step * u * (1.0 - u) * ((1.0 - u) * self.slopes[k] - u * self.slopes[k + 1])
        )

    def _within(self, place: float) -> tuple[int, float, float]:
        k = min(max(bisect_right(self.places, place) - 1, 0), len(self.places) - 2)
        step = self.places[k + 1] - self.places[k]
        return k, min(1.0, max(0.0, (place - self.places[k]) / step)), step


def _slope(before: float, after: float, step_before: float, step_after: float) -> float:
    """Return the slope at a point: the weighted harmonic mean, 0 where the direction changes."""
    if before * after <= 0.0:
        return 0.0
    w1, w2 = 2.0 * step_after + step_before, step_after + 2.0 * step_before
    return (w1 + w2) / (w1 / before + w2 / after)
