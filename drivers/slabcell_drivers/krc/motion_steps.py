"""How far along a way is the robot at a moment, if each section of the way has a speed of its own?

The quickest run from rest to rest: within a section its speed and acceleration are kept, and a section is entered no
faster than it, or what can be slowed down to behind it, allows.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

__all__ = ["Section", "SpeedSteps"]


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a way: how long it is, and the speed and the acceleration that hold on it, in one unit of distance."""

    length: float
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class _Piece:
    """A stretch of even acceleration."""

    begins_s: float
    begins_at: float
    speed: float
    acceleration: float
    duration_s: float

    def at(self, time_s: float) -> float:
        past_s = time_s - self.begins_s
        return self.begins_at + past_s * (self.speed + 0.5 * self.acceleration * past_s)

    def time_at(self, place: float) -> float:
        way = place - self.begins_at
        root = math.sqrt(max(0.0, self.speed**2 + 2.0 * self.acceleration * way))
        return self.begins_s + (2.0 * way / (self.speed + root) if self.speed + root > 0.0 else 0.0)


@dataclass(frozen=True, slots=True)
class SpeedSteps:
    """A distance covered from rest to rest with the speeds of its sections."""

    distance: float
    duration_s: float
    ramp_s: float
    """How long the speed rises at the start."""
    pieces: tuple[_Piece, ...]

    @classmethod
    def fastest(cls, sections: Sequence[Section]) -> "SpeedSteps":
        """Return the quickest run through the sections, those without length left out.

        Raises ValueError if nothing is left, or unless speeds and accelerations are positive.
        """
        sections = [section for section in sections if section.length > 0.0]
        if not sections or any(not (s.speed > 0.0 and s.acceleration > 0.0) for s in sections):
            msg = "sections with a length, a speed and an acceleration above 0 are needed"
            raise ValueError(msg)
        speeds = _speeds_between(sections)
        pieces: list[_Piece] = []
        time_s, place = 0.0, 0.0
        for section, enter, leave in zip(sections, speeds[:-1], speeds[1:], strict=True):
            a = section.acceleration
            peak = min(section.speed, math.sqrt(a * section.length + 0.5 * (enter**2 + leave**2)))
            peak = max(peak, enter, leave)  # rounding only
            up, down = (peak**2 - enter**2) / (2.0 * a), (peak**2 - leave**2) / (2.0 * a)
            even = max(0.0, section.length - up - down)
            for speed, acceleration, length, duration_s in (
                (enter, a, up, (peak - enter) / a),
                (peak, 0.0, even, even / peak),
                (peak, -a, down, (peak - leave) / a),
            ):
                if duration_s > 0.0:
                    pieces.append(_Piece(time_s, place, speed, acceleration, duration_s))
                    time_s, place = time_s + duration_s, place + length
        rising = next((piece for piece in pieces if piece.acceleration <= 0.0), pieces[-1])
        return cls(sum(s.length for s in sections), time_s, rising.begins_s, tuple(pieces))

    def position(self, time_s: float) -> float:
        """Return the distance covered at a time; 0 before the start, all of it after the end."""
        if time_s <= 0.0:
            return 0.0
        if time_s >= self.duration_s:
            return self.distance
        index = bisect_right(self.pieces, time_s, key=lambda piece: piece.begins_s) - 1
        return min(self.distance, self.pieces[index].at(time_s))

    def time_at(self, position: float) -> float:
        """Return when this distance is covered, in seconds after the start; distances beyond either end are clamped."""
        if position <= 0.0:
            return 0.0
        if position >= self.distance:
            return self.duration_s
        index = bisect_right(self.pieces, position, key=lambda piece: piece.begins_at) - 1
        return min(self.duration_s, self.pieces[index].time_at(position))


def _speeds_between(sections: Sequence[Section]) -> list[float]:
    """Return the speed at the start, between the sections and at the end."""
    speeds = [0.0, *(min(a.speed, b.speed) for a, b in pairwise(sections)), 0.0]
    for k, section in enumerate(sections):
        speeds[k + 1] = min(speeds[k + 1], math.sqrt(speeds[k] ** 2 + 2.0 * section.acceleration * section.length))
    for k in range(len(sections) - 1, -1, -1):
        section = sections[k]
        speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] ** 2 + 2.0 * section.acceleration * section.length))
    return speeds
