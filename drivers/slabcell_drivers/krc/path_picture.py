"""What did the tool's way look like?  A picture of moves seen from above and from the side, as SVG text.

Both views have the scale of the root frame: X to the right; above it Y up, below it Z up.  Point-to-point moves are
dashed, path moves are drawn through; dots mark where a move ends, rings what happened on the way.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

from slabcell_drivers.krc.motion import MotionKind, Trajectory
from slabcell_drivers.krc.motion_path import Vector
from slabcell_drivers.robot.frame import Frame

__all__ = ["PathMark", "PathPen", "PathSegment", "draw_path", "segment_of"]

WIDTH_PX = 900
MARGIN_PX = 50
MAX_POINTS = 200_000
SEGMENT_STEP_S = 0.012
FINEST_MM = 0.1
"""A pen leaves out places that are nearer to the last one."""
COLOURS = {
    MotionKind.PTP: "#8c6bb1",
    MotionKind.LIN: "#2b7bba",
    MotionKind.CIRC: "#2a9d5c",
    MotionKind.SPLINE: "#d9822b",
    MotionKind.BLENDED: "#555555",
    MotionKind.STOPPED: "#c0392b",
}


@dataclass(frozen=True, slots=True)
class PathSegment:
    """The tool's way in one move: positions in the root frame, in mm."""

    kind: MotionKind
    points: tuple[Vector, ...]


@dataclass(frozen=True, slots=True)
class PathMark:
    """Something that happened at a place on the way."""

    position: Vector
    text: str


def segment_of(trajectory: Trajectory) -> PathSegment:
    """Return the way of the tool centre point in a planned move."""
    steps = max(1, min(MAX_POINTS, math.ceil(trajectory.duration_s / SEGMENT_STEP_S)))
    times = (trajectory.duration_s * step / steps for step in range(steps + 1))
    return PathSegment(trajectory.kind, tuple(trajectory.tcp_at(time_s).position for time_s in times))


class PathPen:
    """Follows the tool of a controller: the way that it really goes, approximations and stops included.

    It is a `CellIo` of `SoftwareKrc`, whose ``on_trajectory`` calls `begin`; trace the kind "path", so that every step
    of the way is told.
    """

    def __init__(self) -> None:
        self._lines: list[tuple[MotionKind, list[Vector]]] = []
        self.marks: list[PathMark] = []

    @property
    def segments(self) -> list[PathSegment]:
        """The ways of the motions so far."""
        return [PathSegment(kind, tuple(points)) for kind, points in self._lines]

    def begin(self, trajectory: Trajectory) -> None:
        """Take note that this motion begins, where the last one has brought the tool."""
        start = self._lines[-1][1][-1] if self._lines else trajectory.tcp_at(0.0).position
        self._lines.append((trajectory.kind, [start]))

    def moved(self, tcp: Frame) -> None:
        """Draw on to there."""
        if not self._lines:
            return
        points = self._lines[-1][1]
        place = (tcp.x_mm, tcp.y_mm, tcp.z_mm)
        # the last place of a motion always stands: it is taken over by the next step only while that is near
        if len(points) > 2 and math.dist(points[-2], place) < FINEST_MM:
            points[-1] = place
        else:
            points.append(place)

    def output_changed(self, index: int, value: bool, tcp: Frame) -> None:  # noqa: FBT001  # a bit is a value
        """Mark where an output was switched."""
        text = f"$OUT[{index}]={'TRUE' if value else 'FALSE'}"
        self.marks.append(PathMark((tcp.x_mm, tcp.y_mm, tcp.z_mm), text))


def draw_path(segments: Sequence[PathSegment], *, title: str = "", marks: Sequence[PathMark] = ()) -> str:
    """Return the picture as an SVG document.  Raises ValueError if there are too many points to draw."""
    count = sum(len(segment.points) for segment in segments)
    if count > MAX_POINTS:
        msg = f"{count} points; at most {MAX_POINTS} are drawn"
        raise ValueError(msg)
    positions = [point for segment in segments for point in segment.points] + [mark.position for mark in marks]
    positions.append((0.0, 0.0, 0.0))  # the base of the arm
    low = [min(p[i] for p in positions) - 20.0 for i in range(3)]
    high = [max(p[i] for p in positions) + 20.0 for i in range(3)]
    scale = (WIDTH_PX - 2 * MARGIN_PX) / (high[0] - low[0])
    above = _View(0, 1, low, high, scale, top_px=MARGIN_PX + 20)
    side = _View(0, 2, low, high, scale, top_px=above.bottom_px + MARGIN_PX)
    height = side.bottom_px + MARGIN_PX
    size = f'width="{WIDTH_PX}" height="{height:.0f}" viewBox="0 0 {WIDTH_PX} {height:.0f}"'
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="12">',
        f'<rect width="{WIDTH_PX}" height="{height:.0f}" fill="white"/>',
        f'<text x="{MARGIN_PX}" y="24" font-size="16">{escape(title)}</text>',
        _legend(segments),
        *_draw_view(above, segments, marks, "from above: X right, Y up, mm"),
        *_draw_view(side, segments, marks, "from the side: X right, Z up, mm"),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


@dataclass(frozen=True, slots=True)
class _View:
    """One projection: which coordinate runs right, which runs up, and how mm become pixels."""

    right: int
    up: int
    low: Sequence[float]
    high: Sequence[float]
    scale: float
    top_px: float

    @property
    def bottom_px(self) -> float:
        return self.top_px + (self.high[self.up] - self.low[self.up]) * self.scale

    def to_px(self, point: Vector) -> tuple[float, float]:
        x = MARGIN_PX + (point[self.right] - self.low[self.right]) * self.scale
        return x, self.bottom_px - (point[self.up] - self.low[self.up]) * self.scale


def _draw_view(view: _View, segments: Sequence[PathSegment], marks: Sequence[PathMark], caption: str) -> list[str]:
    parts = [f'<text x="{MARGIN_PX}" y="{view.top_px - 6:.0f}" fill="#555">{caption}</text>', *_grid(view)]
    for segment in segments:
        if not segment.points:
            continue
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(view.to_px, segment.points))
        dash = ' stroke-dasharray="6 4"' if segment.kind is MotionKind.PTP else ""
        colour = COLOURS[segment.kind]
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"{dash}/>')
        x, y = view.to_px(segment.points[-1])
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{colour}"/>')
    for mark in marks:
        x, y = view.to_px(mark.position)
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="none" stroke="#c0392b" stroke-width="1.5"/>')
        parts.append(f'<text x="{x + 8:.1f}" y="{y - 6:.1f}" fill="#c0392b">{escape(mark.text)}</text>')
    x, y = view.to_px((0.0, 0.0, 0.0))
    parts.append(f'<path d="M{x - 8:.1f} {y:.1f}h16M{x:.1f} {y - 8:.1f}v16" stroke="black"/>')
    return parts


def _grid(view: _View) -> list[str]:
    parts: list[str] = []
    right_px, step = WIDTH_PX - MARGIN_PX, _grid_step(view.high[view.right] - view.low[view.right])
    for value in _multiples(view.low[view.right], view.high[view.right], step):
        x = MARGIN_PX + (value - view.low[view.right]) * view.scale
        parts.append(f'<path d="M{x:.1f} {view.top_px:.1f}V{view.bottom_px:.1f}" stroke="#e4e4e4"/>')
        parts.append(f'<text x="{x:.1f}" y="{view.bottom_px + 14:.1f}" text-anchor="middle">{value:g}</text>')
    for value in _multiples(view.low[view.up], view.high[view.up], step):
        y = view.bottom_px - (value - view.low[view.up]) * view.scale
        parts.append(f'<path d="M{MARGIN_PX} {y:.1f}H{right_px}" stroke="#e4e4e4"/>')
        parts.append(f'<text x="{MARGIN_PX - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    return parts


def _grid_step(span: float) -> float:
    """Return 1, 2 or 5 times a power of ten, so that about eight lines cross the span."""
    rough = span / 8.0
    power = 10.0 ** math.floor(math.log10(rough))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)


def _multiples(low: float, high: float, step: float) -> list[float]:
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _legend(segments: Sequence[PathSegment]) -> str:
    kinds = [kind for kind in MotionKind if any(segment.kind is kind for segment in segments)]
    spans = "".join(f'<tspan fill="{COLOURS[kind]}" dx="14">{kind}</tspan>' for kind in kinds)
    return f'<text x="{WIDTH_PX - MARGIN_PX}" y="24" text-anchor="end">{spans}</text>'
