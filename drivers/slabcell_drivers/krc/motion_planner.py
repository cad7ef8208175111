"""Which trajectory does a motion instruction mean?  Points, frames and speeds of the program, made into a plan."""

import itertools
import math
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion import (
    INTERPOLATION_TICK_S,
    MotionError,
    PathLimits,
    Trajectory,
    as_motion_error,
    plan_circ,
    plan_lin,
    plan_ptp,
)
from slabcell_drivers.krc.motion_blend import Approximation, blend
from slabcell_drivers.krc.motion_joint import plan_lin_joint
from slabcell_drivers.krc.motion_orders import MoveOrder, TriggerOrder
from slabcell_drivers.krc.operators import FRAME_FIELDS, frame_of
from slabcell_drivers.krc.values import EnumConstant, StructValue, Value, text_of
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["AXIS_FIELDS", "MotionPlanner", "MotionVariables", "Planned"]

AXIS_FIELDS = ("A1", "A2", "A3", "A4", "A5", "A6")
_POINT_TO_POINT = frozenset({"PTP", "SPTP"})
_CIRCLES = frozenset({"CIRC", "SCIRC"})
MAX_ADVANCE = 5


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan with the frames it was made for."""

    trajectory: Trajectory
    tool: Frame
    base: Frame
    remarks: tuple[tuple[int, str], ...] = ()
    """Number and text of what the controller notes about it."""


class MotionVariables(Protocol):
    """The system variables that motions read; None stands for one that was never set."""

    def read(self, name: str) -> Value:
        """Return a system variable such as ``$TOOL``."""
        ...


class MotionPlanner:
    """Plans motions of one arm with the speeds and frames that the program has set."""

    def __init__(self, arm: ArmModel, variables: MotionVariables, home: Axes) -> None:
        self.arm = arm
        self.home = home
        self._variables = variables
        self.needs_axis_motion = True  # the first motion of a program has to be a PTP

    # --- system variables ---------------------------------------------------------------------------------------

    @property
    def advance(self) -> int:
        """$ADVANCE."""
        value = self._variables.read("$ADVANCE")
        return min(MAX_ADVANCE, value) if isinstance(value, int) else 3

    @property
    def override(self) -> float:
        """$OV_PRO as a factor."""
        value = self._variables.read("$OV_PRO")
        return min(1.0, max(0.0, value / 100.0)) if isinstance(value, int | float) else 1.0

    @property
    def tool_or_null(self) -> Frame:
        """$TOOL, the flange if it is not set."""
        return self.frame("$TOOL", needed=False)

    @property
    def base_or_null(self) -> Frame:
        """$BASE, the root if it is not set."""
        return self.frame("$BASE", needed=False)

    def frame(self, name: str, *, needed: bool) -> Frame:
        """Return $TOOL or $BASE.  Raises KrlError if it is needed and was never set."""
        value = self._variables.read(name)
        if isinstance(value, StructValue) and value.fields:
            return frame_of(value)
        if needed:
            if name == "$TOOL":
                raise KrlError(RunMessage.TOOL_MISSING, "TOOL not programmed: set $TOOL, with BAS for example")
            raise KrlError(RunMessage.VALUE_INVALID, f"{name} value invalid: set it with BAS before the first motion")
        return Frame()

    def percent(self, name: str, *, first_only: bool) -> float:
        """Return the least of $VEL_AXIS or $ACC_AXIS, or its first value.  Raises KrlError if one was never set."""
        array = self._variables.read(name)
        values: list[float] = []
        for axis in (1,) if first_only else range(1, 7):
            value = array.get((axis,))
            if value is None:
                text = f"{name}[{axis}] value invalid: set it with BAS(#INITMOV,0) before the first motion"
                raise KrlError(RunMessage.VALUE_INVALID, text)
            values.append(float(value))
        return min(values)

    def percents(self, given: frozenset[str]) -> tuple[float, float]:
        """Return speed and acceleration of the axes; WITH gives them by the first axis.  Raises KrlError."""
        speed = self.percent("$VEL_AXIS", first_only="$VEL_AXIS" in given)
        return speed, self.percent("$ACC_AXIS", first_only="$ACC_AXIS" in given)

    def _orientation_is(self, name: str) -> bool:
        orientation = self._variables.read("$ORI_TYPE")
        return isinstance(orientation, EnumConstant) and orientation.name == name

    @property
    def keeps_orientation(self) -> bool:
        """Whether $ORI_TYPE is #CONSTANT."""
        return self._orientation_is("CONSTANT")

    def limits(self) -> PathLimits:
        """Return $VEL and $ACC.  Raises KrlError if they were never set."""
        speeds, accelerations = self._variables.read("$VEL"), self._variables.read("$ACC")

        def member(structure: Value, name: str, shown: str) -> float:
            value = structure.fields.get(name) if isinstance(structure, StructValue) else None
            if value is None:
                text = f"{shown}.{name} value invalid: set it with BAS(#INITMOV,0) before the first motion"
                raise KrlError(RunMessage.VALUE_INVALID, text)
            return float(value)

        return PathLimits(
            member(speeds, "CP", "$VEL"),
            member(accelerations, "CP", "$ACC"),
            member(speeds, "ORI1", "$VEL"),
            member(accelerations, "ORI1", "$ACC"),
        )

    # --- plans --------------------------------------------------------------------------------------------------

    def plan(self, order: MoveOrder, start: Axes) -> Planned:
        """Return the plan of a motion that begins at ``start``.  Raises KrlError with the controller's message."""
        kind, _, relative = order.kind.partition("_")
        if kind not in _POINT_TO_POINT:
            self.check_first(order.kind)
        target = order.points[-1]
        if not isinstance(target, StructValue) or not target.fields:
            raise KrlError(RunMessage.VALUE_INVALID, f"{order.kind}: {text_of(target)} is no position")
        is_axes = any(name in target.fields for name in AXIS_FIELDS)
        needed = not is_axes
        tool, base = self.frame("$TOOL", needed=needed), self.frame("$BASE", needed=needed)
        with self.controller_errors():
            if kind in _POINT_TO_POINT:
                trajectory = self._plan_ptp(order, target, start, tool, base, relative=bool(relative))
            else:
                trajectory = self._plan_path(order, kind, start, tool, base, relative=bool(relative))
        self.needs_axis_motion = False
        return Planned(trajectory, tool, base)

    @contextmanager
    def controller_errors(self) -> Generator[None]:
        """Turn what the arm cannot do into the message that stops the program."""
        try:
            yield
        except MotionError as error:
            raise KrlError(error.number, error.text) from error
        except ArmError as error:
            motion_error = as_motion_error(error)
            raise KrlError(motion_error.number, motion_error.text) from error

    def check_first(self, kind: str) -> None:
        """Refuse this motion if it is the first of a program.  Raises KrlError."""
        if self.needs_axis_motion:
            text = f"{kind}: the first motion after a program is selected has to be a PTP or SPTP"
            raise KrlError(RunMessage.FIRST_MOTION, text)

    def plan_return(self, start: Axes, target: Axes) -> Trajectory:
        """Return the way back to an interrupted path."""
        return plan_ptp(self.arm, start, target, speed_percent=10.0)

    def _plan_ptp(
        self, order: MoveOrder, target: StructValue, start: Axes, tool: Frame, base: Frame, *, relative: bool
    ) -> Trajectory:
        speed, acceleration = self.percents(order.sets if order.kind.startswith("S") else frozenset())
        return plan_ptp(
            self.arm,
            start,
            self.axes_of(target, start, tool, base, relative=relative, reference=order.reference),
            speed_percent=speed,
            acceleration_percent=acceleration,
            tool=tool,
        )

    def axes_of(
        self,
        target: StructValue,
        start: Axes,
        tool: Frame,
        base: Frame,
        *,
        relative: bool = False,
        reference: str = "",
    ) -> Axes:
        """Return the axes of a position.  Raises ArmError if the arm cannot take it."""
        fields = target.fields
        if any(name in fields for name in AXIS_FIELDS):
            given: list[Value] = [fields.get(name) for name in AXIS_FIELDS]
            if relative:
                axes = [start[i] + float(given[i] or 0.0) for i in range(6)]
            else:
                axes = [start[i] if given[i] is None else float(given[i]) for i in range(6)]
            return (axes[0], axes[1], axes[2], axes[3], axes[4], axes[5])
        frame = self.frame_in_base(target, start, tool, base, relative=relative, reference=reference)
        status, turn = fields.get("S"), fields.get("T")
        flange = base @ frame @ tool.inverse()
        if isinstance(status, int):
            return self.arm.inverse(flange, near=start, status=status, turn=turn if isinstance(turn, int) else None)
        # a target without a status is taken with that of the start; where that is impossible, the nearest way
        try:
            return self.arm.inverse(flange, near=start, status=self.arm.status_turn(start)[0])
        except ArmError:
            return self.arm.inverse(flange, near=start)

    def frame_in_base(
        self, target: StructValue, start: Axes, tool: Frame, base: Frame, *, relative: bool, reference: str
    ) -> Frame:
        """Return a Cartesian target in the base, what it leaves out taken from ``start``."""
        fields = target.fields
        complete = all(fields.get(name) is not None for name in FRAME_FIELDS)
        if complete and not relative:
            return frame_of(target)
        now = base.inverse() @ self.arm.forward(start) @ tool
        if not relative:
            known = now.as_tuple()
            return Frame(*(known[i] if fields.get(n) is None else float(fields[n]) for i, n in enumerate(FRAME_FIELDS)))
        shift = frame_of(target)
        if reference == "TOOL":
            return now @ shift
        turned = Frame(0, 0, 0, shift.a_deg, shift.b_deg, shift.c_deg) @ Frame(0, 0, 0, now.a_deg, now.b_deg, now.c_deg)
        return Frame(
            now.x_mm + shift.x_mm,
            now.y_mm + shift.y_mm,
            now.z_mm + shift.z_mm,
            turned.a_deg,
            turned.b_deg,
            turned.c_deg,
        )

    def _plan_path(
        self, order: MoveOrder, kind: str, start: Axes, tool: Frame, base: Frame, *, relative: bool
    ) -> Trajectory:
        limits = self.limits()
        target = self.in_root(order, order.points[-1], start, tool, base, relative=relative)
        if kind in _CIRCLES:
            if len(order.points) != 2:
                raise KrlError(RunMessage.ARGUMENTS, f"{order.kind} needs an auxiliary point and an end point")
            return plan_circ(
                self.arm,
                start,
                self.in_root(order, order.points[0], start, tool, base, relative=relative),
                target,
                limits,
                tool=tool,
                circular_angle_deg=order.angle_deg,
            )
        if self._orientation_is("JOINT"):
            return plan_lin_joint(self.arm, start, target, limits, tool=tool)
        if self.keeps_orientation:
            now = self.arm.forward(start) @ tool
            target = Frame(target.x_mm, target.y_mm, target.z_mm, now.a_deg, now.b_deg, now.c_deg)
        return plan_lin(self.arm, start, target, limits, tool=tool)

    def in_root(
        self, order: MoveOrder, point: Value, start: Axes, tool: Frame, base: Frame, *, relative: bool
    ) -> Frame:
        """Return a point of a path in the root frame.  Raises KrlError if it is no position."""
        if not isinstance(point, StructValue) or not point.fields:
            raise KrlError(RunMessage.VALUE_INVALID, f"{order.kind}: {text_of(point)} is no position")
        if any(name in point.fields for name in AXIS_FIELDS):
            return self.arm.forward(self.axes_of(point, start, tool, base, relative=relative)) @ tool
        return base @ self.frame_in_base(point, start, tool, base, relative=relative, reference=order.reference)

    # --- approximation and triggers -----------------------------------------------------------------------------

    def blend_s(self, order: MoveOrder, before: Trajectory, after: Trajectory) -> float:
        """Return how long before its end a motion passes into the next one."""
        settings = self._variables.read("$APO")
        fields = settings.fields if isinstance(settings, StructValue) else {}

        def setting(name: str) -> float | None:
            value = fields.get(name)
            return None if value is None else float(value)

        words = order.approximation
        approximation = Approximation(
            distance_mm=(setting("CDIS") or 0.0) if words[0] in {"C_DIS", "C_SPL"} or "C_DIS" in words else None,
            angle_deg=(setting("CORI") or 0.0) if "C_ORI" in words else None,
            percent=self._share(words[0], setting("CPTP"), setting("CVEL")),
        )
        return before.duration_s - blend(before, after, approximation).begins_s

    @staticmethod
    def _share(word: str, cptp: float | None, cvel: float | None) -> float:
        """Return the share of the slowing down that is given up: $APO.CPTP, or what $APO.CVEL leaves of the speed."""
        if word == "C_PTP":
            return min(100.0, cptp or 0.0)
        if word == "C_VEL":
            return 100.0 if cvel is None else max(0.0, 100.0 - cvel)
        return 100.0

    def trigger_time_s(self, trajectory: Trajectory, trigger: TriggerOrder, start_s: float, end_s: float) -> float:
        """Return when in its motion a trigger fires; ``start_s`` to ``end_s`` is the way it refers to."""
        at_start = trigger.on_start or (trigger.kind == "DISTANCE" and trigger.position == 0.0)
        time_s = start_s if at_start else end_s
        if trigger.kind == "PATH":
            time_s = self.time_along(trajectory, time_s, trigger.position)
        return max(0.0, time_s + trigger.delay_s)

    def time_along(self, trajectory: Trajectory, from_s: float, offset_mm: float) -> float:
        """Return when the path is so much longer than at ``from_s``; shorter where the offset is negative."""
        if not offset_mm:
            return from_s
        steps = max(1, round(trajectory.duration_s / INTERPOLATION_TICK_S))
        times = [trajectory.duration_s * i / steps for i in range(steps + 1)]
        points = [trajectory.tcp_at(t).position for t in times]
        lengths = [0.0]
        for a, b in itertools.pairwise(points):
            lengths.append(lengths[-1] + math.dist(a, b))
        at = min(int(from_s / trajectory.duration_s * steps), steps - 1) if trajectory.duration_s > 0.0 else 0
        share = (from_s - times[at]) / (times[at + 1] - times[at]) if times[at + 1] > times[at] else 0.0
        wanted = lengths[at] + share * (lengths[at + 1] - lengths[at]) + offset_mm
        for (t0, l0), (t1, l1) in itertools.pairwise(zip(times, lengths, strict=True)):
            if l0 <= wanted <= l1:
                return t0 + (t1 - t0) * ((wanted - l0) / (l1 - l0) if l1 > l0 else 0.0)
        return 0.0 if wanted < 0.0 else trajectory.duration_s
