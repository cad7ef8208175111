"""Which motions are planned, which is carried out now, and where is the arm?  The main run of a program.

The interpreter is the advance run: it plans motions into a queue, `$ADVANCE` of them at most, and this module carries
them out tick by tick.  An approximated motion passes into the next one by superposition: while the end of one fades
out, the start of the next is added to it.
"""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

from slabcell_drivers.krc.cells import Place
from slabcell_drivers.krc.clock import Clock
from slabcell_drivers.krc.code import Activation, Pause
from slabcell_drivers.krc.messages import KrlError, RunMessage
from slabcell_drivers.krc.motion_block import plan_block, stops_of
from slabcell_drivers.krc.motion_hold import PathHold
from slabcell_drivers.krc.motion_move import HeldMoves, Move
from slabcell_drivers.krc.motion_orders import MoveOrder, PathOrder, TriggerOrder
from slabcell_drivers.krc.motion_planner import MotionPlanner, Planned
from slabcell_drivers.krc.motion_settings import applied
from slabcell_drivers.krc.values import Value
from slabcell_drivers.robot.arm import Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["MotionRunner"]

BRAKE_S = 0.2
FAST_BRAKE_S = 0.1
_RATE_OVER_S = 0.004


class MotionRunner:
    """Queue and execution of motions."""

    def __init__(
        self,
        planner: MotionPlanner,
        clock: Clock,
        *,
        moved: Callable[[Frame], None],
        notify: Callable[[int, str], None],
        started: Callable[[Move], None],
        fire: Callable[[TriggerOrder], None],
    ) -> None:
        self.planner = planner
        self.clock = clock
        self._moved = moved
        self._notify = notify
        self._started = started
        self._fire = fire
        self._standing: Axes = planner.home
        self._planned: Axes = planner.home  # where the last motion of the queue ends
        self._queue: deque[Move] = deque()
        self._active: Move | None = None
        self._fading: Move | None = None
        self._pending: list[TriggerOrder] = []
        self._rate = 1.0
        self._rate_change = 0.0  # per second, while braking
        self._spline: list[MoveOrder] | None = None  # the segments of the block that is being read
        self._spline_triggers: list[tuple[int, TriggerOrder]] = []
        self._spline_settings: Sequence[tuple[str, Place, Value]] = ()
        self._path_orders: list[tuple[int, PathOrder]] = []  # of the block, or of the next motion
        self._hold_points = PathHold(ramp_s=BRAKE_S, late=self._stopped_late)
        self._held: list[HeldMoves] = []
        self.reports_every_step = False
        self.travelled_s = 0.0

    # --- what the program sees ----------------------------------------------------------------------------------

    @property
    def is_busy(self) -> bool:
        """Tell whether the main run lags behind: a motion is under way, or waits for one."""
        return self._active is not None or bool(self._queue)

    @property
    def is_held(self) -> bool:
        """Tell whether motions of an interrupt routine stand before those that it interrupted."""
        return bool(self._held)

    @property
    def is_moving(self) -> bool:
        """Tell whether the arm moves now."""
        return self._active is not None and self._rate > 0.0 and not self._hold_points.waits

    @property
    def waits_outside(self) -> bool:
        """Tell whether the arm stands on its path until something outside of time lets it go on."""
        return self._hold_points.waits and not self._hold_points.uses_time

    @property
    def active(self) -> Move | None:
        """The motion that is carried out."""
        return self._active

    @property
    def tool(self) -> Frame:
        """The tool of the main run."""
        return self._active.tool if self._active is not None else self.planner.tool_or_null

    @property
    def base(self) -> Frame:
        """The base of the main run."""
        return self._active.base if self._active is not None else self.planner.base_or_null

    @property
    def tcp(self) -> Frame:
        """The tool centre point in the robot's root."""
        return self.planner.arm.forward(self.axes) @ self.tool

    @property
    def has_room(self) -> bool:
        """Tell whether the advance run may plan another motion."""
        if self._spline is not None:
            return True
        return len(self._queue) < max(1, self.planner.advance) or self._active is None

    def wait_without_advance(self, a: Activation) -> Pause | None:
        """Wait for the motion just planned if $ADVANCE is 0."""
        if self.planner.advance == 0 and self.is_busy and self._spline is None:
            a.pc -= 1
            return Pause.MOTION
        return None

    # --- planning -----------------------------------------------------------------------------------------------

    def move(self, order: MoveOrder) -> None:
        """Plan a motion from where the one before it ends.  Raises KrlError."""
        if self._rate_change < 0.0 or self._rate == 0.0:
            self._hold()
        if self._spline is not None:
            self._spline.append(order)
            self._spline_triggers += [(len(self._spline) - 1, trigger) for trigger in self._pending]
            self._pending.clear()
            return
        planned = self.planner.plan(order, self._planned)
        duration_s = planned.trajectory.duration_s
        triggers = [(trigger, 0.0, duration_s) for trigger in self._pending]
        self._pending.clear()
        self._take(order, planned, triggers)

    def add_path_order(self, order: PathOrder) -> None:
        """Keep what was ordered of the path of the block that is being read, or of the next motion."""
        if self._spline is None and order.kind != "STOP":
            raise KrlError(RunMessage.SYNTAX, f"{order.kind} stands outside of a spline block")
        self._path_orders.append((len(self._spline or ()), order))

    def _take(self, order: MoveOrder, planned: Planned, triggers: list[tuple[TriggerOrder, float, float]]) -> None:
        for number, text in planned.remarks:
            self._notify(number, text)
        path_orders, self._path_orders = self._path_orders, []
        move = Move(order, planned.trajectory, planned.tool, planned.base, bool(order.approximation))
        for trigger, start_s, end_s in triggers:
            move.triggers.append((self.planner.trigger_time_s(move.trajectory, trigger, start_s, end_s), trigger))
        move.triggers.sort(key=lambda item: item[0])
        move.stops = stops_of(self.planner, move.trajectory, path_orders)
        self._planned = move.trajectory.end_axes
        self._enqueue(move)

    def _enqueue(self, move: Move) -> None:
        before = self._queue[-1] if self._queue else self._active
        if before is not None and before.approximated and not before.stops:
            self._blend(before, move)
        self._queue.append(move)
        if self._active is None:
            self._begin_next()

    def _blend(self, before: Move, after: Move) -> None:
        wanted = self.planner.blend_s(before.order, before.trajectory, after.trajectory)
        left = before.trajectory.duration_s - before.elapsed_s
        blend = min(wanted, before.trajectory.duration_s / 2, after.trajectory.duration_s / 2)
        if before is not self._active or left >= blend:
            before.blend_s = blend

    def add_trigger(self, trigger: TriggerOrder) -> None:
        """Keep a trigger for the next motion."""
        self._pending.append(trigger)

    def begin_spline(self, values: Sequence[tuple[str, Place, Value]]) -> None:
        """Begin a spline block: its settings hold for all its segments that have none of their own."""
        self._spline_settings = values
        self._spline = []
        self._path_orders.clear()

    def end_spline(self, order: MoveOrder) -> None:
        """End a spline block: all its segments are one motion.  Raises KrlError."""
        segments, self._spline = self._spline or [], None
        triggers, self._spline_triggers = self._spline_triggers, []
        if not segments:
            self._path_orders.clear()
            return
        with applied(self._spline_settings):
            order = replace(order, settings=tuple(self._spline_settings))
            planned = plan_block(self.planner, order, segments, self._planned, self._path_orders)
        marks = (0.0, *planned.trajectory.marks_s, planned.trajectory.duration_s)
        last = len(marks) - 2
        self._take(order, planned, [(t, marks[min(i, last)], marks[min(i, last) + 1]) for i, t in triggers])

    # --- execution ----------------------------------------------------------------------------------------------

    def step(self, seconds: float) -> None:
        """Carry the motions on by so much time."""
        if self._active is None:
            return
        if self._rate_change < 0.0:
            self._rate = max(0.0, self._rate + self._rate_change * seconds)
            if self._rate == 0.0:
                self._rate_change = 0.0
        left = seconds * self._rate * self.planner.override
        if left > 0.0:
            left = self._hold_points.allowed(self._active.stops, self._active.elapsed_s, left)
        if left <= 0.0:
            return
        self.travelled_s += left
        ended = False
        while left > 1e-12 and (move := self.active) is not None:
            if ended and move.stops:
                break  # it begins with the next tick, which looks at its stops
            left, finished = self._step_active(move, left)
            ended = ended or finished
        if ended or self.reports_every_step:
            self._moved(self.tcp)

    def _step_active(self, move: Move, left: float) -> tuple[float, bool]:
        duration = move.trajectory.duration_s
        passes_on = bool(self._queue) and move.blend_s > 0.0
        end = duration - move.blend_s if passes_on else duration
        used = min(left, max(0.0, end - move.elapsed_s))
        self._advance(move, used)
        if self._fading is not None:
            self._advance(self._fading, used)
            if self._fading.elapsed_s >= self._fading.trajectory.duration_s:
                self._fading = None
        if move.elapsed_s < end - 1e-12 or self._hold_points.blocks(move.stops, move.elapsed_s):
            return 0.0, False
        if passes_on:
            self._fading = move
            self._active = None
            self._begin_next()
            return left - used, True
        if move.approximated and duration > 0.0:
            self._notify(RunMessage.APPROXIMATION_NOT_POSSIBLE, "Approximation not possible")
        self._advance(move, 1.0)  # what was to happen behind the end
        self._standing = move.trajectory.end_axes
        self._active = None
        self._begin_next()
        return left - used, True

    def _stopped_late(self, where: str) -> None:
        self._notify(RunMessage.CONDITIONAL_STOP, f"Conditional stop in {where} active after a delay")

    def _advance(self, move: Move, seconds: float) -> None:
        move.elapsed_s += seconds
        while move.triggers and move.triggers[0][0] <= move.elapsed_s + 1e-9:
            self._fire(move.triggers.pop(0)[1])

    def _begin_next(self) -> None:
        if self._queue:
            self._active = self._queue.popleft()
            self._started(self._active)
            self._advance(self._active, 0.0)
        elif not self._held:
            self._planned = self._standing

    @property
    def axes(self) -> Axes:
        """Where the axes are now."""
        return self._axes_before(0.0)

    @property
    def axis_rates_deg_s(self) -> Axes:
        """How fast each axis turns, over the last milliseconds."""
        if not self.is_moving:
            return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        now, before = self._axes_before(0.0), self._axes_before(_RATE_OVER_S)
        factor = self._rate * self.planner.override / _RATE_OVER_S
        a1, a2, a3, a4, a5, a6 = ((n - b) * factor for n, b in zip(now, before, strict=True))
        return (a1, a2, a3, a4, a5, a6)

    @property
    def tcp_speed_m_s(self) -> float:
        """How fast the tool centre point moves, over the last milliseconds."""
        if not self.is_moving:
            return 0.0
        arm, tool = self.planner.arm, self.tool
        now = (arm.forward(self._axes_before(0.0)) @ tool).as_tuple()[:3]
        before = (arm.forward(self._axes_before(_RATE_OVER_S)) @ tool).as_tuple()[:3]
        return math.dist(now, before) * self._rate * self.planner.override / (1000.0 * _RATE_OVER_S)

    def _axes_before(self, seconds: float) -> Axes:
        """Return where the axes were on their plan, so long before now."""
        active, fading = self._active, self._fading
        if active is None:
            return self._standing
        now = active.trajectory.axes_at(active.elapsed_s - seconds)
        if fading is None:
            return now
        rest, end = fading.trajectory.axes_at(fading.elapsed_s - seconds), fading.trajectory.end_axes
        return (
            now[0] + rest[0] - end[0],
            now[1] + rest[1] - end[1],
            now[2] + rest[2] - end[2],
            now[3] + rest[3] - end[3],
            now[4] + rest[4] - end[4],
            now[5] + rest[5] - end[5],
        )

    # --- braking ------------------------------------------------------------------------------------------------

    def brake(self, *, fast: bool) -> None:
        """Slow down to a standstill on the path."""
        if self._active is None:
            self._rate = 0.0
        else:
            self._rate_change = -1.0 / (FAST_BRAKE_S if fast else BRAKE_S)

    def _hold(self) -> None:
        """Put what was braked aside, for the motions of an interrupt routine."""
        self._standing = self.axes
        self._held.append(HeldMoves(self._standing, self._active, self._fading, self._queue, self._planned))
        self._active, self._fading, self._queue = None, None, deque()
        self._planned = self.axes
        self._rate, self._rate_change = 1.0, 0.0

    def release(self) -> None:
        """Go on with what was braked; if the arm was moved meanwhile, back to the place first."""
        self._rate, self._rate_change = 1.0, 0.0
        if not self._held:
            return
        held = self._held.pop()
        rest = list(self._queue)
        self._queue = deque(rest)
        if self._active is None and self.axes != held.axes:
            back = self.planner.plan_return(self.axes, held.axes)
            self._active = Move(
                MoveOrder.returning(), back, self.planner.tool_or_null, self.planner.base_or_null, approximated=False
            )
        if held.active is not None:
            self._queue.append(held.active)
        self._queue.extend(held.queue)
        self._planned = held.planned
        if self._active is None:
            self._active = self._queue.popleft() if self._queue else None
            self._fading = held.fading

    def discard(self) -> None:
        """Drop every motion that is planned or under way; the arm stands where it is."""
        self._standing = self.axes
        self._queue.clear()
        self._held.clear()
        self._pending.clear()
        self._path_orders.clear()
        self._hold_points.clear()
        self._active = self._fading = None
        self._spline = None
        self._rate, self._rate_change = 1.0, 0.0
        self._planned = self.axes

    def place_at(self, axes: Axes) -> None:
        """Put the arm there without a motion: a start position."""
        self.discard()
        self._standing = self._planned = axes
