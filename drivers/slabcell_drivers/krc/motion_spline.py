"""How does the tool move through a spline block?  SPL, SLIN and SCIRC segments as one way without a stop.

Simplification against the controller: between SPL points the way is a cubic with the tangents of neighbouring points
(Catmull-Rom over chord length), and the speed changes only where the settings of a segment ask for it; the controller's
own curve and its slowing down in bends are not public.  Every programmed point is passed exactly, as on the controller.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from slabcell_drivers.krc.messages import MotionMessage
from slabcell_drivers.krc.motion import MotionError, MotionKind, PathLimits, Trajectory, plan_path, tcp_pose
from slabcell_drivers.krc.motion_path import Arc, Line, OrientedPath, PointPath, Vector
from slabcell_drivers.robot.arm import ArmModel, Axes
from slabcell_drivers.robot.arm_solve import Pose, pose_of_frame
from slabcell_drivers.robot.frame import Frame

__all__ = ["SegmentKind", "SplineSegment", "plan_spline"]

TABLE_STEPS = 32  # chords that a cubic's length is measured with


class SegmentKind(StrEnum):
    """How a segment of a block runs."""

    SPL = "SPL"
    SLIN = "SLIN"
    SCIRC = "SCIRC"


@dataclass(frozen=True, slots=True)
class SplineSegment:
    """One segment: to ``target`` (tool centre point in the root frame), for SCIRC through ``auxiliary``."""

    kind: SegmentKind
    target: Frame
    auxiliary: Frame | None = None
    circular_angle_deg: float | None = None
    limits: PathLimits | None = None
    """Of this segment alone; None for those of the block."""


def plan_spline(
    arm: ArmModel, start: Axes, segments: Sequence[SplineSegment], limits: PathLimits, *, tool: Frame
) -> Trajectory:
    """Return the move through all segments; ``marks_s`` has the time of each target but the last.

    Raises MotionError as `slabcell_drivers.krc.motion.plan_lin` does, and for a block without segments.
    """
    if not segments:
        raise MotionError(MotionMessage.VALUE, "SPLINE: a block needs at least one segment")
    poses = [tcp_pose(arm, start, tool), *(pose_of_frame(segment.target) for segment in segments)]
    tangents = _tangents(poses, segments)
    parts: list[OrientedPath] = []
    for i, segment in enumerate(segments):
        path = _segment_path(segment, poses[i], poses[i + 1], tangents[i], tangents[i + 1])
        parts.append(OrientedPath.between(path, poses[i], poses[i + 1]))
    sections = [segment.limits or limits for segment in segments]
    return plan_path(arm, MotionKind.SPLINE, start, _Chain.of(parts), limits, tool, sections=sections)


def _segment_path(segment: SplineSegment, start: Pose, end: Pose, leave: Vector, arrive: Vector) -> PointPath:
    if segment.kind is SegmentKind.SLIN:
        return Line(start.position, end.position)
    if segment.kind is SegmentKind.SPL:
        return _Cubic.between(start.position, end.position, leave, arrive)
    if segment.auxiliary is None:
        raise MotionError(MotionMessage.CIRCLE, "SCIRC without an auxiliary point")
    middle = pose_of_frame(segment.auxiliary).position
    try:
        return Arc.through(start.position, middle, end.position, angle_deg=segment.circular_angle_deg)
    except ValueError as error:
        raise MotionError(MotionMessage.CIRCLE, f"SCIRC not possible: {error}") from error


def _tangents(poses: Sequence[Pose], segments: Sequence[SplineSegment]) -> list[Vector]:
    """Return the direction, of length 1, in which each point is passed."""
    found: list[Vector] = []
    for i in range(len(poses)):
        before = _direction(poses[i - 1].position, poses[i].position) if i else None
        after = _direction(poses[i].position, poses[i + 1].position) if i + 1 < len(poses) else None
        # a straight neighbour rules: the curve leaves it along its own line
        if i and segments[i - 1].kind is SegmentKind.SLIN:
            after = None
        elif before is not None and i < len(segments) and segments[i].kind is SegmentKind.SLIN:
            before = None
        b, a = before or (0.0, 0.0, 0.0), after or (0.0, 0.0, 0.0)
        found.append(_unit((b[0] + a[0], b[1] + a[1], b[2] + a[2])))
    return found


def _direction(start: Vector, end: Vector) -> Vector:
    return _unit((end[0] - start[0], end[1] - start[1], end[2] - start[2]))


def _unit(v: Vector) -> Vector:
    size = math.hypot(*v)
    return (v[0] / size, v[1] / size, v[2] / size) if size > 1e-9 else (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Cubic:
    """A cubic between two points with given tangents, run through at even speed by a table of its length."""

    start: Vector
    end: Vector
    leave: Vector
    arrive: Vector
    lengths: tuple[float, ...]

    @classmethod
    def between(cls, start: Vector, end: Vector, leave: Vector, arrive: Vector) -> "_Cubic":
        chord = math.dist(start, end)
        bare = cls(
            start,
            end,
            (leave[0] * chord, leave[1] * chord, leave[2] * chord),
            (arrive[0] * chord, arrive[1] * chord, arrive[2] * chord),
            (),
        )
        points = [bare.point(k / TABLE_STEPS) for k in range(TABLE_STEPS + 1)]
        lengths = [0.0]
        for p, q in pairwise(points):
            lengths.append(lengths[-1] + math.dist(p, q))
        return cls(start, end, bare.leave, bare.arrive, tuple(lengths))

    @property
    def length_mm(self) -> float:
        return self.lengths[-1]

    def at(self, fraction: float) -> Vector:
        wanted = min(max(fraction, 0.0), 1.0) * self.length_mm
        k = min(bisect_right(self.lengths, wanted), TABLE_STEPS) - 1
        step = self.lengths[k + 1] - self.lengths[k]
        return self.point((k + ((wanted - self.lengths[k]) / step if step > 0.0 else 0.0)) / TABLE_STEPS)

    def point(self, u: float) -> Vector:
        """Return the point at the curve's own parameter."""
        h0, h1 = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * u * (3.0 - 2.0 * u)
        g0, g1 = u * (1.0 - u) ** 2, u * u * (u - 1.0)
        x, y, z = (h0 * self.start[i] + h1 * self.end[i] + g0 * self.leave[i] + g1 * self.arrive[i] for i in range(3))
        return (x, y, z)


@dataclass(frozen=True, slots=True)
class _Chain:
    """Several ways, one after another; a part that only turns the tool counts by its angle, 1° as 1 mm."""

    parts: tuple[OrientedPath, ...]
    ends: tuple[float, ...]
    length_mm: float
    angle_deg: float

    @classmethod
    def of(cls, parts: Sequence[OrientedPath]) -> "_Chain":
        ends: list[float] = []
        total = 0.0
        for part in parts:
            total += part.length_mm if part.length_mm > 1e-6 else part.angle_deg
            ends.append(total)
        scale = 1.0 / total if total > 0.0 else 0.0
        fractions = tuple(end * scale for end in ends)
        # the fastest turning part decides how fast the whole may be run
        angle = max((p.angle_deg / s for p, s in zip(parts, _shares(fractions), strict=True) if s > 0.0), default=0.0)
        return cls(tuple(parts), fractions, total, angle)

    @property
    def marks(self) -> tuple[float, ...]:
        return self.ends[:-1]

    def at(self, fraction: float) -> Pose:
        k = min(bisect_right(self.ends, fraction), len(self.parts) - 1)
        begin = self.ends[k - 1] if k else 0.0
        share = self.ends[k] - begin
        return self.parts[k].at(min(1.0, (fraction - begin) / share) if share > 0.0 else 1.0)


def _shares(ends: Sequence[float]) -> list[float]:
    return [end - begin for begin, end in zip([0.0, *ends], ends, strict=False)]
