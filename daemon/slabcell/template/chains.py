"""Which lines and arcs make one outline?  Curves are joined where their ends meet, until they are closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from slabcell.geometry import Points
from slabcell.template.model import Problem

__all__ = ["Chain", "Chains", "join_chains", "place_of"]

SAME_MM: Final = 1e-3
"""Points of one curve that are nearer are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """One curve of a drawing, or several joined: points (n, 2) mm, and of which layer and entity (the first)."""

    points: Points
    closed: bool
    layer: str
    handle: str
    thickness_mm: float | None


@dataclass(frozen=True, slots=True)
class Chains:
    """What came of joining."""

    closed: list[Chain]
    problems: list[Problem]


def place_of(handle: str, layer: str) -> str:
    """Return where something is drawn, as messages have it."""
    return f": entity {handle} on layer {layer[:60]}"


def join_chains(curves: Sequence[Chain], join_mm: float) -> Chains:
    """Return the closed outlines that curves make, and what stays open.

    Curves of one layer only are joined.  ``join_mm``: ends as near as that meet.
    """
    closed: list[Chain] = []
    problems: list[Problem] = []
    open_by_layer: dict[str, list[Chain]] = {}
    for curve in curves:
        points = _tidy(curve.points, closed=curve.closed)
        ends_meet = len(points) > 2 and float(np.hypot(*(points[0] - points[-1]))) <= join_mm
        if curve.closed or ends_meet:
            closed.append(
                replace(curve, points=points if curve.closed else _tidy(points[:-1], closed=True), closed=True)
            )
        elif len(points) > 1:
            open_by_layer.setdefault(curve.layer, []).append(replace(curve, points=points))
    for pieces in open_by_layer.values():
        _join(pieces, join_mm, closed, problems)
    return Chains(closed, problems)


def _join(pieces: list[Chain], join_mm: float, closed: list[Chain], problems: list[Problem]) -> None:
    """Join the open pieces of one layer."""
    partner = _partners(pieces, join_mm, problems)
    if partner is None:
        return
    done: set[int] = set()
    # Chains with a loose end begin there; what is left over then goes round.
    starts = sorted(range(2 * len(pieces)), key=lambda end: end in partner)
    for start in starts:
        if start // 2 in done:
            continue
        run: list[Points] = []
        end = start
        while end // 2 not in done:
            piece = pieces[end // 2]
            done.add(end // 2)
            run.append(piece.points if end % 2 == 0 else piece.points[::-1])
            end = partner.get(end ^ 1, end)
        first = pieces[start // 2]
        points = _tidy(np.concatenate(run), closed=False, near_mm=join_mm)
        gap = float(np.hypot(*(points[0] - points[-1])))
        if len(points) > 3 and gap <= join_mm:
            closed.append(replace(first, points=_tidy(points[:-1], closed=True), closed=True))
            continue
        at = (float(points[-1, 0]), float(points[-1, 1]))
        values = {"gap_mm": gap, "x": at[0], "y": at[1], "most_mm": join_mm}
        outline = (tuple((float(x), float(y)) for x, y in points),)
        place = place_of(first.handle, first.layer)
        problems.append(Problem("open_chain", place, values, at_mm=at, outlines_mm=outline))


def _partners(pieces: list[Chain], join_mm: float, problems: list[Problem]) -> dict[int, int] | None:
    """Return which end meets which, by 2 x piece for a start and 2 x piece + 1 for an end; None if it is not sure."""
    ends = np.array([piece.points[index] for piece in pieces for index in (0, -1)])
    near = cKDTree(ends).query_pairs(join_mm, output_type="ndarray")
    meets: dict[int, list[int]] = {}
    for one, other in near.tolist():
        meets.setdefault(int(one), []).append(int(other))
        meets.setdefault(int(other), []).append(int(one))
    branches = sorted(end for end, others in meets.items() if len(others) > 1)
    said: set[int] = set()
    for end in branches:
        if end in said:
            continue
        said.update([end, *meets[end]])
        at = (float(ends[end, 0]), float(ends[end, 1]))
        piece = pieces[end // 2]
        values = {"count": len(meets[end]) + 1, "x": at[0], "y": at[1]}
        problems.append(Problem("branch", place_of(piece.handle, piece.layer), values, at_mm=at))
    return None if branches else {end: others[0] for end, others in meets.items()}


def _tidy(points: Points, *, closed: bool, near_mm: float = SAME_MM) -> Points:
    """Return the points without those that repeat the one before; of a closed curve, the last may repeat the first."""
    if len(points) < 2:
        return points
    apart = np.hypot(*np.diff(points, axis=0).T)
    kept = points[np.concatenate([[True], apart > near_mm])]
    if not closed and near_mm > SAME_MM and not np.array_equal(kept[-1], points[-1]):
        kept[-1] = points[-1]
    while closed and len(kept) > 1 and float(np.hypot(*(kept[0] - kept[-1]))) <= SAME_MM:
        kept = kept[:-1]
    return kept
