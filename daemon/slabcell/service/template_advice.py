"""What would the cell make of this template?  What nobody can lay, and what is worth knowing before it is laid.

Faults of the file are found when it is read (`slabcell.template`).  This is about slabs: does the gripper find a place
on each, which ones are the same, and which ones look so much alike that the vision would refuse them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import shapely
from shapely.ops import nearest_points

from slabcell.geometry import Points, Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Problem
from slabcell.template.checks import SLIVER_MM
from slabcell.vision.ambiguity import kinds_of
from slabcell.vision.grasp import choose_grasp
from slabcell.vision.outline import distance_to_outline
from slabcell.vision.symmetry import symmetry_order

__all__ = ["advise"]

NARROW_MM: Final = 0.5
"""Gaps below this are rarely meant; neighbours that touch are."""
LEVER_MM: Final = 5.0
"""A grip so far from the centre of mass tilts a slab."""
MOST: Final = 200
"""Findings of one kind."""
TURNS: Final = 72
"""Rotations in which two outlines are compared."""
RIM_POINTS: Final = 120
MAX_PAIRS: Final = 4_000


def advise(recipe: Recipe) -> list[Problem]:
    """Return what is worth knowing of a recipe's template, the most important first; blocks."""
    slots = recipe.template.slots
    kinds = kinds_of(slots, recipe.matching.alike_mm)
    found: list[Problem] = []
    for several in (_grips(recipe), _confusable(recipe, kinds), _gaps(slots), _alike(slots, kinds), _turns(recipe)):
        found += [item for item, _ in zip(several, range(MOST), strict=False)]
    return found


def _grips(recipe: Recipe) -> Iterator[Problem]:
    """Say which slabs the gripper cannot take, and which only beside their middle."""
    for number, slot in enumerate(recipe.template.slots):
        grasp = choose_grasp(slot, recipe.grasp, number)
        if grasp.point is None:
            needed_mm = recipe.grasp.cup_radius_mm + recipe.grasp.margin_mm
            yield _of("no_grasp", slot, number, detail=grasp.refusal, needed_mm=round(needed_mm, 2))
        elif grasp.lever_mm > LEVER_MM:
            at = (float(grasp.point[0]), float(grasp.point[1]))
            yield Problem(
                "off_centre", "", {"slot": number, "lever_mm": round(grasp.lever_mm, 2)}, (number,), at, advice=True
            )


def _alike(slots: tuple[Polygon, ...], kinds: tuple[int, ...]) -> Iterator[Problem]:
    """Say which slots have the same outline."""
    groups: dict[int, list[int]] = {}
    for number, kind in enumerate(kinds):
        groups.setdefault(kind, []).append(number)
    for group in groups.values():
        if len(group) > 1:
            shown = ", ".join(map(str, group[:20])) + (" ..." if len(group) > 20 else "")
            outlines = tuple(_ring(slots[number]) for number in group[:20])
            yield Problem("alike", "", {"others": shown}, tuple(group), _middle(slots[group[0]]), outlines, advice=True)


def _confusable(recipe: Recipe, kinds: tuple[int, ...]) -> Iterator[Problem]:
    """Say which slots of different outlines the vision may not tell apart, as far as their outlines go.

    The RMS distance of the outlines in the best of some rotations is an upper bound of what tells them apart; noise of
    the picture, and what the vision leaves over, come on top.
    """
    slots, needed_mm = recipe.template.slots, recipe.matching.min_lead_mm
    models = [kinds.index(kind) for kind in sorted(set(kinds))]
    areas = np.array([slots[number].area_mm2 for number in models])
    pairs = 0
    for first, number in enumerate(models):
        # An outline that is off by the lead everywhere changes the area by no more than this.
        near = np.abs(areas - areas[first]) <= 4.0 * needed_mm * slots[number].perimeter_mm
        for second in np.flatnonzero(near).tolist():
            if second <= first:
                continue
            pairs += 1
            if pairs > MAX_PAIRS:
                return
            other = models[second]
            apart_mm = _apart_mm(slots[number], slots[other])
            if apart_mm < 2.0 * needed_mm:
                values = {"slot": number, "other": other, "apart_mm": round(apart_mm, 3), "needed_mm": needed_mm}
                outlines = (_ring(slots[number]), _ring(slots[other]))
                yield Problem("confusable", "", values, (number, other), _middle(slots[other]), outlines, advice=True)


def _apart_mm(first: Polygon, second: Polygon) -> float:
    """Return the least RMS distance of two outlines over rotations about their centroids."""
    along = np.linspace(0.0, 1.0, RIM_POINTS, endpoint=False)
    exterior = first.shape.exterior
    rim = np.array([exterior.interpolate(float(at), normalized=True).coords[0] for at in along]) - first.centroid
    other: Points = second.vertices - second.centroid

    def apart(turn_deg: float) -> float:
        return float(np.sqrt(np.mean(distance_to_outline(RigidTransform2D(turn_deg, 0.0, 0.0).apply(rim), other) ** 2)))

    best = min((360.0 * step / TURNS for step in range(TURNS)), key=apart)
    for step in (2.0, 0.5, 0.1):
        best = min((best + step * shift for shift in range(-3, 4)), key=apart)
    return apart(best)


def _turns(recipe: Recipe) -> Iterator[Problem]:
    """Say which slabs fit in several rotations."""
    for number, slot in enumerate(recipe.template.slots):
        order = symmetry_order(slot, recipe.matching.alike_mm)
        if order > 1:
            yield _of("turns", slot, number, order=order)


def _gaps(slots: tuple[Polygon, ...]) -> Iterator[Problem]:
    """Say between which neighbours there is a gap that is too narrow to be meant."""
    shapes = [slot.shape for slot in slots]
    tree = shapely.STRtree(shapes)
    for number, shape in enumerate(shapes):
        for other in sorted(int(hit) for hit in tree.query(shape, predicate="dwithin", distance=NARROW_MM)):
            if other <= number:
                continue
            here, there = nearest_points(shape, shapes[other])
            gap_mm = float(here.distance(there))
            if SLIVER_MM < gap_mm < NARROW_MM:
                at = (float(here.x + there.x) / 2, float(here.y + there.y) / 2)
                values = {"slot": number, "other": other, "gap_mm": round(gap_mm, 3)}
                yield Problem("gap", "", values, (number, other), at, advice=True)


def _of(kind: str, slot: Polygon, number: int, **values: str | float) -> Problem:
    return Problem(kind, "", {"slot": number, **values}, (number,), _middle(slot), (_ring(slot),), advice=True)


def _middle(slot: Polygon) -> tuple[float, float]:
    inside = slot.shape.representative_point()
    return float(inside.x), float(inside.y)


def _ring(slot: Polygon) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in slot.vertices)
