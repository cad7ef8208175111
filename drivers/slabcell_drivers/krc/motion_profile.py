"""How far along a path is the robot at a moment?  Ramp up, constant speed, ramp down."""

import math
from dataclasses import dataclass

__all__ = ["Trapezoid"]


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """A distance covered from rest to rest: speed rises to ``peak_speed`` in ``ramp_s``, stays, and falls again.

    The units are those of the distance that it was made for (mm, degrees or a fraction of a path).
    """

    distance: float
    peak_speed: float
    ramp_s: float
    duration_s: float

    @classmethod
    def fastest(cls, distance: float, speed: float, acceleration: float) -> "Trapezoid":
        """Return the quickest profile within these limits; a triangle if the full speed is not reached.

        Raises ValueError unless speed and acceleration are positive and the distance is not negative.
        """
        if not (speed > 0.0 and acceleration > 0.0 and distance >= 0.0):
            msg = f"distance {distance}, speed {speed}, acceleration {acceleration}: the last two must be above 0"
            raise ValueError(msg)
        if distance == 0.0:
            return cls(0.0, 0.0, 0.0, 0.0)
        peak = min(speed, math.sqrt(distance * acceleration))
        ramp_s = peak / acceleration
        return cls(distance, peak, ramp_s, ramp_s + distance / peak)

    def position(self, time_s: float) -> float:
        """Return the distance covered at a time; 0 before the start, all of it after the end."""
        if time_s >= self.duration_s:
            return self.distance
        if time_s <= 0.0:
            return 0.0
        if time_s < self.ramp_s:
            return 0.5 * self.peak_speed * time_s * time_s / self.ramp_s
        left_s = self.duration_s - time_s
        if left_s < self.ramp_s:
            return self.distance - 0.5 * self.peak_speed * left_s * left_s / self.ramp_s
        return self.peak_speed * (time_s - 0.5 * self.ramp_s)

    def time_at(self, position: float) -> float:
        """Return when this distance is covered, in seconds after the start; distances beyond either end are clamped."""
        if position <= 0.0:
            return 0.0
        if position >= self.distance:
            return self.duration_s
        ramp_distance = 0.5 * self.peak_speed * self.ramp_s
        if position < ramp_distance:
            return math.sqrt(2.0 * position * self.ramp_s / self.peak_speed)
        left = self.distance - position
        if left < ramp_distance:
            return self.duration_s - math.sqrt(2.0 * left * self.ramp_s / self.peak_speed)
        return position / self.peak_speed + 0.5 * self.ramp_s
