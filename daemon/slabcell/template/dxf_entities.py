"""Which curves and texts does a drawing hold?  Entities with blocks expanded, in millimetres, seen from above."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from slabcell.geometry import Points
from slabcell.template.chains import Chain, place_of
from slabcell.template.checks import MAX_POINTS
from slabcell.template.csv_file import MAX_NAME
from slabcell.template.model import Problem

__all__ = ["Found", "Layers", "read_entities"]

MAX_ENTITIES: Final = 20_000
MAX_DEPTH: Final = 8
FLAT_MM: Final = 0.1
"""By how much the heights of one outline may differ."""
_CURVES: Final = frozenset({"LWPOLYLINE", "POLYLINE", "LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE"})
_TEXTS: Final = frozenset({"TEXT", "MTEXT", "ATTRIB"})
_THICKNESS: Final = re.compile(r"(?<![\d.,])(\d{1,3}(?:[.,]\d{1,3})?)[ _]?mm(?![a-z])", re.IGNORECASE)


@dataclass(slots=True)
class Found:
    """What the entities hold, in millimetres."""

    chains: list[Chain] = field(default_factory=list[Chain])
    texts: list[tuple[float, float, str]] = field(default_factory=list[tuple[float, float, str]])
    problems: list[Problem] = field(default_factory=list[Problem])
    passed_over: Counter[str] = field(default_factory=Counter[str])


class Layers:
    """Which layers are read?"""

    def __init__(self, document: Any, wanted: Sequence[str]) -> None:
        self.known: dict[str, str] = {}
        self._hidden: set[str] = {"defpoints"}
        for layer in document.layers:
            name = str(layer.dxf.name)
            self.known[name.casefold()] = name
            if layer.is_off() or layer.is_frozen():
                self._hidden.add(name.casefold())
        for space in document.blocks:  # the model space is one; a layer need not be declared to be drawn on
            for entity in space:
                name = str(entity.dxf.get("layer", "0"))
                self.known.setdefault(name.casefold(), name)
        self._wanted = {name.casefold() for name in wanted}
        self.missing = next((name for name in wanted if name.casefold() not in self.known), "")
        self.said = ", ".join(wanted) if wanted else "all that are shown"

    def shown(self, layer: str) -> bool:
        """Return whether anything of a layer is looked at: names may stand on other layers than outlines."""
        return layer.casefold() not in self._hidden

    def outlines(self, layer: str) -> bool:
        """Return whether a layer has outlines."""
        return layer.casefold() in self._wanted if self._wanted else self.shown(layer)


def read_entities(document: Any, mm: float, layers: Layers, chord_mm: float) -> Found:
    """Return what the model space of a drawing holds; ``mm`` is its unit, arcs become chords that leave them so far."""
    return _Reader(mm, layers, chord_mm).read(document)


class _Reader:
    def __init__(self, mm: float, layers: Layers, chord_mm: float) -> None:
        self._mm, self._layers, self._chord_mm = mm, layers, chord_mm
        self._found = Found()

    def read(self, document: Any) -> Found:
        """Return what the model space holds."""
        try:
            _Weights(document).require(document.modelspace())
            for entity, layer, handle in self._expand(document.modelspace(), "", ""):
                self._take(entity, layer, handle)
        except _BoundsError as error:
            self._found.problems.append(error.problem)
        except Exception as error:  # noqa: BLE001 - what the library trips over is the drawing's fault
            self._found.problems.append(Problem("not_dxf", "", {"detail": type(error).__name__}))
        return self._found

    def _expand(self, entities: Any, above: str, handle: str) -> Iterator[tuple[Any, str, str]]:
        """Yield each entity with its layer and the handle by which it is found in the drawing, blocks expanded."""
        for entity in entities:
            layer = str(entity.dxf.get("layer", "0"))
            layer = above if layer == "0" and above else layer  # layer 0 in a block is that of its insertion
            own = handle or str(entity.dxf.handle or "?")
            if entity.dxftype() != "INSERT":
                yield entity, layer, own
            elif self._layers.shown(layer):
                for copy in entity.multi_insert() if entity.mcount > 1 else (entity,):
                    yield from ((attribute, layer, own) for attribute in copy.attribs)
                    yield from self._expand(copy.virtual_entities(), layer, own)

    def _take(self, entity: Any, layer: str, handle: str) -> None:
        kind = str(entity.dxftype())
        if kind in _TEXTS and self._layers.shown(layer):
            self._text(entity, kind)
        elif not self._layers.outlines(layer):
            return
        elif kind in _CURVES:
            self._curve(entity, kind, layer, handle)
        elif kind not in _TEXTS:
            self._found.passed_over[kind] += 1

    def _text(self, entity: Any, kind: str) -> None:
        try:
            place = entity.dxf.insert if kind == "MTEXT" else entity.ocs().to_wcs(entity.dxf.insert)
            words = " ".join(str(entity.plain_text()).split())[:MAX_NAME]
            where = (float(place.x) * self._mm, float(place.y) * self._mm)
        except Exception:  # noqa: BLE001 - a broken text is no name
            return
        if words and all(math.isfinite(value) for value in where):
            self._found.texts.append((*where, words))

    def _curve(self, entity: Any, kind: str, layer: str, handle: str) -> None:
        place = place_of(handle, layer)
        try:
            spatial, closed = _points_of(entity, kind, self._chord_mm / self._mm)
        except Exception as error:  # noqa: BLE001 - as in _parse
            values = {"kind": kind, "detail": type(error).__name__}
            self._found.problems.append(Problem("bad_entity", place, values))
            return
        spatial = spatial * self._mm
        if len(spatial) == 0 or not np.isfinite(spatial).all() or np.abs(spatial).max() > 1e9:
            values = {"kind": kind, "detail": "it has no finite points"}
            self._found.problems.append(Problem("bad_entity", place, values))
            return
        height = float(np.ptp(spatial[:, 2]))
        if height > FLAT_MM:
            at = (float(spatial[0, 0]), float(spatial[0, 1]))
            self._found.problems.append(Problem("not_flat", place, {"kind": kind, "height_mm": height}, at_mm=at))
            return
        own = float(entity.dxf.get("thickness", 0.0) or 0.0) if entity.dxf.is_supported("thickness") else 0.0
        thickness = abs(own) * self._mm or _layer_thickness(layer)
        self._found.chains.append(Chain(spatial[:, :2], closed, layer, handle, thickness))


class _BoundsError(Exception):
    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.kind)
        self.problem = problem


class _Weights:
    """How many entities is a drawing with its blocks expanded?  Counted before anything is."""

    def __init__(self, document: Any) -> None:
        self._blocks = document.blocks
        self._known: dict[str, tuple[int, int]] = {}
        """Of each block: entities, and how deep blocks stand in it."""

    def require(self, space: Any) -> None:
        """Raise _BoundsError for a drawing of more entities, or of blocks deeper in each other, than are read."""
        if self._weigh(space, 0)[0] > MAX_ENTITIES:
            raise _BoundsError(Problem("too_many_entities", "", {"most": MAX_ENTITIES}))

    def _weigh(self, entities: Any, depth: int) -> tuple[int, int]:
        count, height = 0, 0
        for entity in entities:
            count += 1
            if entity.dxftype() != "INSERT":
                continue
            name = str(entity.dxf.get("name", "")).casefold()
            known = self._known.get(name)
            below = depth + 1 + (known[1] if known else 0)
            if below > MAX_DEPTH:
                place = place_of(str(entity.dxf.handle or "?"), str(entity.dxf.get("layer", "0")))
                raise _BoundsError(Problem("too_deep", place, {"most": MAX_DEPTH}))
            block = self._blocks.get(name)
            if block is None:
                continue
            if known is None:
                self._known[name] = known = self._weigh(block, depth + 1)
            count += max(1, int(entity.mcount)) * known[0]
            height = max(height, 1 + known[1])
        return count, height


def _points_of(entity: Any, kind: str, chord: float) -> tuple[Points, bool]:
    """Return a curve's points, (n, 3) in the drawing's unit, and whether it is closed."""
    if kind == "LINE":
        return _array([entity.dxf.start, entity.dxf.end]), False
    if kind in ("ARC", "CIRCLE"):
        chord = min(chord, 0.5 * abs(float(entity.dxf.radius)))
        _bound_chords(abs(float(entity.dxf.radius)), chord)
        points = _array(entity.flattening(chord))
        return (points[:-1], True) if kind == "CIRCLE" else (points, False)
    if kind in ("ELLIPSE", "SPLINE"):
        if kind == "SPLINE" and len(entity.control_points) + len(entity.fit_points) > MAX_POINTS:
            msg = "too many control points"
            raise ValueError(msg)
        points = _array(_at_most(entity.flattening(chord), 4 * MAX_POINTS))
        closed = len(points) > 3 and bool(np.allclose(points[0], points[-1], atol=1e-9 + 0.1 * chord))
        return (points[:-1] if closed else points), closed
    return _polyline(entity, kind, chord)


def _polyline(entity: Any, kind: str, chord: float) -> tuple[Points, bool]:
    """Return the points of a polyline, its bulges flattened."""
    if kind == "LWPOLYLINE":
        rows = [(x, y, bulge) for x, y, bulge in entity.get_points("xyb")]
        height, closed = float(entity.dxf.get("elevation", 0.0)), bool(entity.closed)
        corners = np.array([(x, y, height) for x, y, _ in rows], np.float64).reshape(-1, 3)
        bulges = [float(bulge) for *_, bulge in rows]
    else:
        if entity.is_poly_face_mesh or entity.is_polygon_mesh:
            msg = "a mesh is no outline"
            raise ValueError(msg)
        closed = bool(entity.is_closed)
        corners = _array([vertex.dxf.location for vertex in entity.vertices if not vertex.dxf.flags & 16])
        bulges = [float(vertex.dxf.get("bulge", 0.0) or 0.0) for vertex in entity.vertices if not vertex.dxf.flags & 16]
        if entity.is_3d_polyline:
            return corners, closed
    points: list[Points] = []
    for index, corner in enumerate(corners):
        points.append(corner[None])
        if bulges[index] and (closed or index + 1 < len(corners)):
            points.append(_arc(corner, corners[(index + 1) % len(corners)], bulges[index], chord))
    flat = np.concatenate(points) if points else np.zeros((0, 3))
    return _array(entity.ocs().points_to_wcs([tuple(map(float, point)) for point in flat])), closed


def _arc(start: Points, end: Points, bulge: float, chord: float) -> Points:
    """Return the points between the ends of a polyline's arc, (n, 3); bulge is the tangent of a quarter of it."""
    along = end - start
    length = float(np.hypot(along[0], along[1]))
    angle = 4.0 * math.atan(bulge)
    if length < 1e-12 or abs(angle) < 1e-9:
        return np.zeros((0, 3))
    radius = length / (2.0 * abs(math.sin(angle / 2.0)))
    _bound_chords(radius, chord)
    step = 2.0 * math.acos(max(-1.0, 1.0 - min(chord, 0.5 * radius) / radius))
    count = math.ceil(abs(angle) / step)
    # The centre lies beside the middle of the chord, to the left for arcs that turn left by less than half a circle.
    normal = np.array([-along[1], along[0]]) / length
    centre = (start + end)[:2] / 2.0 + normal * (length / 2.0) / math.tan(angle / 2.0)
    turns = angle * np.arange(1, count) / count
    spoke = start[:2] - centre
    turned = np.exp(1j * turns) * complex(*spoke)
    moved = np.stack([turned.real, turned.imag])
    return np.column_stack([(moved + centre[:, None]).T, np.full(len(turns), start[2])])


def _bound_chords(radius: float, chord: float) -> None:
    """Raise ValueError for an arc that takes more chords than an outline may have points."""
    if not radius > 0 or math.pi / math.acos(max(-1.0, 1.0 - min(chord, 0.5 * radius) / radius)) > 50 * MAX_POINTS:
        msg = "its radius is none"
        raise ValueError(msg)


def _at_most(points: Any, most: int) -> list[Any]:
    kept: list[Any] = []
    for point in points:
        kept.append(point)
        if len(kept) > most:
            msg = "too many points"
            raise ValueError(msg)
    return kept


def _array(points: Any) -> Points:
    return np.array([(float(point[0]), float(point[1]), float(point[2])) for point in points], np.float64).reshape(
        -1, 3
    )


def _layer_thickness(layer: str) -> float | None:
    said = _THICKNESS.search(layer)
    return float(said[1].replace(",", ".")) or None if said else None
