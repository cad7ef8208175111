"""Where is the flange at these axis angles, and which axis angles bring it there?  The six-axis KUKA arm as data.

An `ArmModel` is a KUKA arm with a spherical wrist: dimensions by the names of ``$machine.dat``, axis limits, speeds and
accelerations.  It is *not* responsible for tool, base or time: poses here are the flange in the robot's root frame.

Status and turn are those of KRL's POS: bits 0, 1 and 2 of S say that the wrist point lies behind the A1 axis, that A3
is at or above the angle at which the arm is stretched, and that A5 is negative; bit i of T says that axis i + 1 is
negative.  Checked against taught points of public controller backups; bit 0 set and bit 1 clear were not among them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from slabcell_drivers.robot.arm_solve import Axes, Dimensions, Pose, Vector, flange_pose, pose_of_frame, solve
from slabcell_drivers.robot.frame import Frame

__all__ = ["KR3_R540", "KR6_R900", "ArmError", "ArmFault", "ArmModel", "Axes", "arm_by_name"]

TURN_DISREGARDED_WITHIN_DEG = 2.0
"""A turn bit that no solution has is disregarded if its axis is this near zero; from a report, not from a manual."""

ALL_ZERO: Axes = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ALL_STATUS_BITS = 0b111
HALF_TURN_DEG = 180.0 - 1e-6
LIMIT_TOLERANCE_DEG = 1e-7  # rounding of a pose that was taught at the limit itself


class ArmFault(StrEnum):
    """Why there are no axis angles for a pose."""

    UNREACHABLE = "unreachable"
    AXIS_LIMIT = "axis_limit"


class ArmError(Exception):
    """A pose cannot be taken.  ``axis`` (1 to 6), ``value_deg`` and ``limit_deg`` are set for an axis limit."""

    def __init__(
        self,
        message: str,
        fault: ArmFault,
        *,
        axis: int | None = None,
        value_deg: float | None = None,
        limit_deg: float | None = None,
    ) -> None:
        super().__init__(message)
        self.fault = fault
        self.axis = axis
        self.value_deg = value_deg
        self.limit_deg = limit_deg


@dataclass(frozen=True, slots=True)
class ArmModel:
    """One arm: dimensions, and for A1 to A6 limits, speeds (deg/s) and accelerations (deg/s²) at 100 %."""

    name: str
    dimensions: Dimensions
    axis_min_deg: Axes
    axis_max_deg: Axes
    axis_speed_deg_s: Axes
    axis_acceleration_deg_s2: Axes

    def forward(self, axes_deg: Axes) -> Frame:
        """Return the flange in the root frame."""
        return flange_pose(self.dimensions, axes_deg).to_frame()

    def forward_pose(self, axes_deg: Axes) -> Pose:
        """Return the flange in the root frame as position and rotation matrix: for loops over many poses."""
        return flange_pose(self.dimensions, axes_deg)

    def all_solutions(self, flange: Frame | Pose, *, near: Axes | None = None) -> list[Axes]:
        """Return every set of axis angles within the limits, whole turns included; the nearest to ``near`` first.

        Where the wrist or shoulder is singular, A4 or A1 is taken from ``near`` (0 without).
        """
        reference = near or ALL_ZERO
        found = [axes for _, branch in self._branches(flange, reference, None) for axes in self._expand(branch)]
        found.sort(key=lambda axes: self.travel_time_s(reference, axes))
        return found

    def inverse(
        self, flange: Frame | Pose, *, near: Axes | None = None, status: int | None = None, turn: int | None = None
    ) -> Axes:
        """Return the axis angles that bring the flange there.

        Of several the one that is quickest to reach from ``near`` (all axes 0 without).  ``status`` restricts to one
        configuration, ``turn`` to one sign of each axis.  Raises ArmError: out of reach, or an axis beyond its limit.
        """
        reference = near or ALL_ZERO
        best, best_time = None, math.inf
        branches = self._branches(flange, reference, status, None if status is not None else self._may_stand)
        for _, branch in branches:
            axes = self._nearest(branch, reference) if turn is None else self._turned(branch, reference, turn)
            if axes is None:
                continue
            if len(branches) == 1:
                return axes
            time_s = self.travel_time_s(reference, axes)
            if time_s < best_time:
                best, best_time = axes, time_s
        if best is None:
            raise self._refusal(flange, reference, self._branches(flange, reference, status), status, turn)
        return best

    def reachable(self, flange: Frame | Pose, *, status: int | None = None) -> bool:
        """Tell whether the flange can be brought there within the axis limits."""
        try:
            self.inverse(flange, status=status)
        except ArmError:
            return False
        return True

    def status_turn(self, axes_deg: Axes) -> tuple[int, int]:
        """Return S and T of these axis angles."""
        d = self.dimensions
        a2, a23 = math.radians(axes_deg[1]), math.radians(axes_deg[1] + axes_deg[2])
        wrist_x = (
            d.shoulder_mm
            + d.upper_arm_mm * math.cos(a2)
            + d.forearm_x_mm * math.cos(a23)
            + d.forearm_z_mm * math.sin(a23)
        )
        stretched_deg = math.degrees(math.atan2(d.forearm_z_mm, d.forearm_x_mm))
        status = (wrist_x < 0.0) | (axes_deg[2] >= stretched_deg) << 1 | (axes_deg[4] < 0.0) << 2
        turn = sum((axes_deg[i] < 0.0) << i for i in range(6))
        return int(status), turn

    def check_limits(self, axes_deg: Axes) -> None:
        """Raise ArmError, naming axis, value and limit, if an axis is beyond its limit."""
        for i, value in enumerate(axes_deg):
            low, high = self.axis_min_deg[i], self.axis_max_deg[i]
            if not low - LIMIT_TOLERANCE_DEG <= value <= high + LIMIT_TOLERANCE_DEG:
                limit = low if value < low else high
                raise ArmError(
                    f"{self.name}: A{i + 1} at {value:.3f}° is beyond its limit of {limit:.3f}°",
                    ArmFault.AXIS_LIMIT,
                    axis=i + 1,
                    value_deg=value,
                    limit_deg=limit,
                )

    def within_limits(self, axes_deg: Axes) -> bool:
        """Tell whether every axis is within its limits."""
        return all(
            low - LIMIT_TOLERANCE_DEG <= value <= high + LIMIT_TOLERANCE_DEG
            for low, value, high in zip(self.axis_min_deg, axes_deg, self.axis_max_deg, strict=True)
        )

    def travel_time_s(self, start: Axes, end: Axes) -> float:
        """Return how long the slowest axis needs at full speed, ramps left out: a measure of nearness."""
        longest_s = 0.0
        for begin, stop, speed in zip(start, end, self.axis_speed_deg_s, strict=True):
            longest_s = max(longest_s, abs(stop - begin) / speed)
        return longest_s

    def _may_stand(self, main_axes_deg: Vector) -> bool:
        """Tell whether A1, A2, A3 are within their limits after some number of whole turns."""
        for axis, angle in enumerate(main_axes_deg):
            within = self.axis_min_deg[axis] <= angle <= self.axis_max_deg[axis]
            if not within and not self._turns_of(axis, angle):
                return False
        return True

    def _branches(
        self,
        flange: Frame | Pose,
        reference: Axes,
        status: int | None,
        allowed: Callable[[Vector], bool] | None = None,
    ) -> list[tuple[int, Axes]]:
        pose = flange if isinstance(flange, Pose) else pose_of_frame(flange)
        return solve(
            self.dimensions,
            pose,
            a1_if_singular_deg=reference[0],
            a4_if_singular_deg=reference[3],
            status=None if status is None else status & ALL_STATUS_BITS,
            allowed=allowed,
        )

    def _nearest(self, branch: Axes, reference: Axes) -> Axes | None:
        """Return the branch with the whole turns that bring each axis nearest to the reference; None beyond a limit."""
        chosen: list[float] = []
        limits = zip(branch, reference, self.axis_min_deg, self.axis_max_deg, strict=True)
        for i, (angle, target, low, high) in enumerate(limits):
            if low <= angle <= high and -HALF_TURN_DEG < angle - target < HALF_TURN_DEG:
                chosen.append(angle)  # no whole turn brings it nearer
                continue
            angles = self._turns_of(i, angle)
            if not angles:
                return None
            chosen.append(min(angles, key=lambda angle, target=target: abs(angle - target)))
        return (chosen[0], chosen[1], chosen[2], chosen[3], chosen[4], chosen[5])

    def _turned(self, branch: Axes, reference: Axes, turn: int) -> Axes | None:
        """Return the branch with the whole turns that ``turn`` asks, of these the nearest to the reference.

        None if the limits of an axis allow none.  A turn bit is disregarded near zero where no angle has it.
        """
        chosen: list[float] = []
        for i in range(6):
            angles = self._turns_of(i, branch[i])
            negative = bool(turn >> i & 1)
            fitting = [angle for angle in angles if (angle < 0.0) == negative]
            angles = fitting or [angle for angle in angles if abs(angle) <= TURN_DISREGARDED_WITHIN_DEG]
            if not angles:
                return None
            target = reference[i]
            chosen.append(angles[0] if len(angles) == 1 else min(angles, key=lambda angle: abs(angle - target)))
        return (chosen[0], chosen[1], chosen[2], chosen[3], chosen[4], chosen[5])

    def _turns_of(self, axis: int, angle: float) -> list[float]:
        """Return the angle with every number of whole turns that the limits of its axis allow."""
        low, high = self.axis_min_deg[axis] - LIMIT_TOLERANCE_DEG, self.axis_max_deg[axis] + LIMIT_TOLERANCE_DEG
        found: list[float] = []
        turned = angle - 360.0 * math.floor((angle - low) / 360.0)
        while turned <= high:
            found.append(turned)
            turned += 360.0
        return found

    def _expand(self, branch: Axes) -> list[Axes]:
        """Return the branch with every number of whole turns on every axis that its limits allow."""
        found: list[list[float]] = [[]]
        for i, value in enumerate(branch):
            found = [[*head, angle] for head in found for angle in self._turns_of(i, value)]
        return [(a[0], a[1], a[2], a[3], a[4], a[5]) for a in found]

    def _refusal(
        self,
        flange: Frame | Pose,
        reference: Axes,
        branches: list[tuple[int, Axes]],
        status: int | None,
        turn: int | None,
    ) -> ArmError:
        """Return why there are no axis angles."""
        if not branches:
            if not self._branches(flange, reference, None):
                return self._unreachable(flange)
            message = f"{self.name}: {_describe(flange)} cannot be reached with status {status}; choose another status"
            return ArmError(message, ArmFault.UNREACHABLE)
        candidates = [axes for _, branch in branches for axes in self._expand(branch)]
        if not candidates or turn is None:
            return self._beyond_limit(flange, [branch for _, branch in branches])
        return self._beyond_turn(flange, candidates, turn)

    def _unreachable(self, flange: Frame | Pose) -> ArmError:
        d = self.dimensions
        pose = flange if isinstance(flange, Pose) else pose_of_frame(flange)
        wx, wy, wz = (pose.position[i] - d.flange_mm * pose.rotation[i][2] for i in range(3))
        distance = math.hypot(math.hypot(wx, wy) - d.shoulder_mm, wz - d.base_height_mm)
        forearm = math.hypot(d.forearm_x_mm, d.forearm_z_mm)
        longest, shortest = d.upper_arm_mm + forearm, abs(d.upper_arm_mm - forearm)
        message = (
            f"{self.name}: {_describe(flange)} is out of reach: the wrist would be {distance:.1f} mm from the A2 axis, "
            f"and {shortest:.1f} to {longest:.1f} mm are possible"
        )
        return ArmError(message, ArmFault.UNREACHABLE)

    def _beyond_limit(self, flange: Frame | Pose, branches: list[Axes]) -> ArmError:
        """Name the worst axis of the branch that comes nearest to being allowed."""

        def worst(branch: Axes) -> tuple[float, int, float, float]:
            excess = [(0.0, 0, 0.0, 0.0)]
            for i, value in enumerate(branch):
                low, high = self.axis_min_deg[i], self.axis_max_deg[i]
                beyond = [(low - v, i, v, low) if v < low else (v - high, i, v, high) for v in _turns(value, low, high)]
                excess.append(min(beyond))
            return max(excess)

        _, i, value, limit = min(worst(branch) for branch in branches)
        message = f"{self.name}: {_describe(flange)} needs A{i + 1} at {value:.3f}°, beyond its limit of {limit:.3f}°"
        return ArmError(message, ArmFault.AXIS_LIMIT, axis=i + 1, value_deg=value, limit_deg=limit)

    def _beyond_turn(self, flange: Frame | Pose, candidates: list[Axes], turn: int) -> ArmError:
        wrong = min(([i for i in range(6) if (a[i] < 0.0) != bool(turn >> i & 1)], a) for a in candidates)
        i = wrong[0][0]
        value = wrong[1][i] + (-360.0 if turn >> i & 1 else 360.0)
        limit = self.axis_min_deg[i] if turn >> i & 1 else self.axis_max_deg[i]
        message = (
            f"{self.name}: {_describe(flange)} with turn {turn} needs A{i + 1} at {value:.3f}°, "
            f"beyond its limit of {limit:.3f}°"
        )
        return ArmError(message, ArmFault.AXIS_LIMIT, axis=i + 1, value_deg=value, limit_deg=limit)


def _turns(value: float, low: float, high: float) -> list[float]:
    """Return the value and its whole turns next to the range."""
    middle = (low + high) / 2.0
    base = value + 360.0 * round((middle - value) / 360.0)
    return [base - 360.0, base, base + 360.0]


def _describe(flange: Frame | Pose) -> str:
    x, y, z, a, b, c = (flange.to_frame() if isinstance(flange, Pose) else flange).as_tuple()
    return f"flange X {x:.1f} Y {y:.1f} Z {z:.1f} A {a:.1f} B {b:.1f} C {c:.1f}"


def _ramped(speeds: Axes, ramp_s: float) -> Axes:
    return (
        speeds[0] / ramp_s,
        speeds[1] / ramp_s,
        speeds[2] / ramp_s,
        speeds[3] / ramp_s,
        speeds[4] / ramp_s,
        speeds[5] / ramp_s,
    )


ASSUMED_RAMP_S = 0.25
"""Accelerations are not public: every axis is assumed to reach its full speed in this time."""

_KR3_SPEEDS: Axes = (530.0, 529.0, 538.0, 600.0, 600.0, 800.0)
_KR6_SPEEDS: Axes = (360.0, 300.0, 360.0, 381.0, 388.0, 615.0)

KR3_R540 = ArmModel(
    name="KR 3 R540",
    dimensions=Dimensions(345.0, 20.0, 260.0, 260.0, 20.0, 75.0),
    axis_min_deg=(-170.0, -170.0, -110.0, -175.0, -120.0, -350.0),
    axis_max_deg=(170.0, 50.0, 155.0, 175.0, 120.0, 350.0),
    axis_speed_deg_s=_KR3_SPEEDS,
    axis_acceleration_deg_s2=_ramped(_KR3_SPEEDS, ASSUMED_RAMP_S),
)
"""KR 3 R540; dimensions, limits and speeds as published by ROS-Industrial (``kuka_kr3_support``)."""

KR6_R900 = ArmModel(
    name="KR 6 R900",
    dimensions=Dimensions(400.0, 25.0, 455.0, 420.0, 35.0, 80.0),
    axis_min_deg=(-170.0, -190.0, -120.0, -185.0, -120.0, -350.0),
    axis_max_deg=(170.0, 45.0, 156.0, 185.0, 120.0, 350.0),
    axis_speed_deg_s=_KR6_SPEEDS,
    axis_acceleration_deg_s2=_ramped(_KR6_SPEEDS, ASSUMED_RAMP_S),
)
"""KR 6 R900 sixx; dimensions and limits from its machine data, speeds as ROS-Industrial has them."""


def arm_by_name(name: str) -> ArmModel:
    """Return a known arm by its short name, in any case and with any separators.  Raises ValueError otherwise."""
    known = {"kr3r540": KR3_R540, "kr6r900": KR6_R900}
    plain = "".join(character for character in name.lower() if character.isalnum())
    if plain not in known:
        msg = f"no arm is called {name!r}; known: {', '.join(known)}"
        raise ValueError(msg)
    return known[plain]
