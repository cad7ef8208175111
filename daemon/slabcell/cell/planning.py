"""Which parts can the robot lay, in which order, and with which poses?  Between the vision and the ledger.

Both poses of a pair are the tool centre point with its Z axis down (B 0, C 180).  The direction of a round tool is
free, as long as it is the same on the part at both ends, and a part that looks alike after a turn may be laid turned:
both are chosen so that the wrist turns least.  A picture from above knows no heights: slabs of one thickness never
hinder a tool that touches their upper faces, and everything else that may stand in the way has to be a forbidden zone.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt
import shapely

from slabcell.catalogue import Fault
from slabcell.cell.laying import LayingOrder
from slabcell.cell.records import Pair
from slabcell.cell.settings import CellSettings
from slabcell.geometry import PlanarPose, Points, RigidTransform2D, normalize_deg
from slabcell.recipe import Recipe
from slabcell.vision.result import LocatedPart
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.arm_solve import Pose
from slabcell_drivers.robot.frame import Frame

__all__ = ["Plan", "Planner", "Refusal"]

TOOL_TURNS_DEG = tuple(float(angle) for angle in range(-150, 181, 30))
"""Directions of the tool on the part that are considered."""

FEW_TURNS_DEG = (0.0, 180.0, 90.0, -90.0)
"""The same where each costs an inverse kinematics."""

STRAIGHT_MM, STRAIGHT_DEG = 1e-3, 1e-3
"""A tool whose axis is the flange's within this only turns A6 when it turns."""

SAME_MM = 1e-6

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Refusal:
    """A part that was located and is not laid, and why."""

    slot: int
    fault: Fault
    detail: str


@dataclass(frozen=True, slots=True)
class Plan:
    """Pairs in the order in which they shall be laid, and what is left out."""

    pairs: tuple[Pair, ...]
    refused: tuple[Refusal, ...]


@dataclass(frozen=True, slots=True)
class _Reached:
    """Axes at pick and place with the tool as it was asked for."""

    pick: Axes
    place: Axes


class Planner:
    """Plans for one product in one cell; what does not change from picture to picture is computed once."""

    def __init__(self, recipe: Recipe, settings: CellSettings, arm: ArmModel) -> None:
        self._recipe = recipe
        self._settings = settings
        self._arm = arm
        self._order = LayingOrder(recipe.template.slots)
        self._pick_base, self._place_base = settings.pick_base.matrix, settings.place_base.matrix
        self._from_tcp = np.linalg.inv(settings.tool.matrix)
        x, y, _, _, b, c = settings.tool.as_tuple()
        # Several cups, or one beside the tool's axis, stand on the slab as the vision has chosen, and in no other way.
        free = list(recipe.grasp.cups_mm) == [(0.0, 0.0)]
        self._turns_deg = TOOL_TURNS_DEG if free else (0.0,)
        self._few_turns_deg = FEW_TURNS_DEG if free else (0.0,)
        self._straight = math.hypot(x, y) < STRAIGHT_MM and math.hypot(b, c) < STRAIGHT_DEG
        self._zones = [(zone.shape, zone.shape.buffer(settings.gripper_radius_mm)) for zone in settings.forbidden]

    def plan(
        self,
        parts: Sequence[LocatedPart],
        *,
        laid: Collection[int] = (),
        correction_mm: tuple[float, float] = (0.0, 0.0),
    ) -> Plan:
        """Return what can be done with the located parts, when the slots ``laid`` are filled already.

        ``correction_mm`` is added to every place in x and y of the assembly.
        """
        if correction_mm != (0.0, 0.0):
            parts = [replace(part, place=_shifted(part.place, correction_mm)) for part in parts]
        refused: list[Refusal] = []
        possible: dict[int, LocatedPart] = {}
        for part in sorted(parts, key=lambda item: item.slot):
            problem = self._outside(part)
            if problem is None:
                possible[part.slot] = part
            else:
                refused.append(problem)
        pairs: list[Pair] = []
        wrist_deg: float | None = None
        for slot in self._order.order(possible, laid):
            try:
                pair, wrist_deg = self._pair(possible[slot], wrist_deg, correction_mm)
            except ArmError as error:
                refused.append(Refusal(slot, Fault.UNREACHABLE, str(error)))
                continue
            pairs.append(pair)
        return Plan(tuple(pairs), tuple(sorted(refused, key=lambda item: item.slot)))

    def _outside(self, part: LocatedPart) -> Refusal | None:
        """Tell whether tool or slab would be where they must not."""
        point = shapely.Point(part.pick.x_mm, part.pick.y_mm)
        where = f"X {part.pick.x_mm:.1f} Y {part.pick.y_mm:.1f} of the table"
        if not self._settings.pick_area.shape.covers(point):
            return Refusal(
                part.slot, Fault.OUTSIDE_WORKSPACE, f"the grasp point at {where} is outside of the pick area"
            )
        to_table = self._settings.assembly_in_table
        x, y = to_table.apply(np.array([part.place.x_mm, part.place.y_mm]))
        outline = self._recipe.template.slots[part.slot].transformed(to_table).shape
        for number, (zone, grown) in enumerate(self._zones, start=1):
            if grown.contains(point):
                return Refusal(part.slot, Fault.OUTSIDE_WORKSPACE, f"the tool at {where} is in forbidden zone {number}")
            if grown.contains(shapely.Point(float(x), float(y))) or zone.intersects(outline):
                return Refusal(part.slot, Fault.COLLISION, f"slot {part.slot} lies in forbidden zone {number}")
        return None

    def _pair(
        self, part: LocatedPart, wrist_deg: float | None, correction_mm: tuple[float, float]
    ) -> tuple[Pair, float]:
        """Return the poses of one part, and where A6 stands after it was laid.  Raises ArmError."""
        places = self._alike(part, correction_mm)
        if self._straight:
            options = [
                (self._wrist_travel(axes, turn, wrist_deg), turn, place)
                for (axes, place), turn in product(self._reached(part.pick, places), self._turns_deg)
            ]
            (_, last), turn, place = min(options, key=lambda option: (option[0][0], abs(option[1])))
        else:
            turn, place, last = self._first_reached(part, places)
        pair = Pair(part.slot, self._down(part.pick, turn), self._down(place, turn), part.score)
        return pair, last

    def _alike(self, part: LocatedPart, correction_mm: tuple[float, float]) -> list[PlanarPose]:
        """Return the ways to lay the part that look the same."""
        order = max(1, min(part.symmetry_order, 12))
        middle: Points = self._recipe.template.slots[part.slot].centroid + np.array(correction_mm)
        place = part.place
        found = [place]
        for step in range(1, order):
            turn_deg = 360.0 * step / order
            arm = np.array([place.x_mm, place.y_mm]) - middle
            x, y = middle + RigidTransform2D(turn_deg, 0.0, 0.0).apply(arm)
            found.append(PlanarPose(float(x), float(y), normalize_deg(place.a_deg + turn_deg)))
        return found

    def _wrist_travel(self, axes: _Reached, turn_deg: float, before_deg: float | None) -> tuple[float, float]:
        """Return how far A6 turns to the pick and on to the place, and where it ends, within its limits."""
        low, high = self._arm.axis_min_deg[5], self._arm.axis_max_deg[5]
        best = (math.inf, 0.0)
        for at_pick in _turns(axes.pick[5] + turn_deg, low, high):
            for at_place in _turns(axes.place[5] + turn_deg, low, high):
                start = at_pick if before_deg is None else before_deg
                travel = abs(at_pick - start) + abs(at_place - at_pick)
                best = min(best, (travel, at_place))
        return best

    def _first_reached(self, part: LocatedPart, places: list[PlanarPose]) -> tuple[float, PlanarPose, float]:
        problem: ArmError | None = None
        for turn, place in product(self._few_turns_deg, places):
            try:
                (axes, _), *_ = self._reached(_turned(part.pick, turn), [_turned(place, turn)])
            except ArmError as error:
                problem = problem or error
                continue
            return turn, place, axes.place[5]
        assert problem is not None  # noqa: S101  (there is at least one way, and none was reached)
        raise problem

    def _reached(self, pick: PlanarPose, places: list[PlanarPose]) -> list[tuple[_Reached, PlanarPose]]:
        """Return the ways to lay a part that the arm reaches; raises ArmError if there is none."""
        at_pick = self._descend(self._pick_base, pick)
        found: list[tuple[_Reached, PlanarPose]] = []
        problem: ArmError | None = None
        for place in places:
            if found and self._straight and _same_point(found[0][1], place):
                # Gripped in its middle: laid turned, only A6 differs, and by the turn itself.
                axes = found[0][0].place
                turned = axes[5] + place.a_deg - found[0][1].a_deg
                found.append((_Reached(at_pick, (*axes[:5], turned)), place))
                continue
            try:
                found.append((_Reached(at_pick, self._descend(self._place_base, place)), place))
            except ArmError as error:
                problem = problem or error
        if problem is not None and not found:
            raise problem
        return found

    def _descend(self, base: Matrix, pose: PlanarPose) -> Axes:
        """Return the axes at a pose; raises ArmError unless the arm gets straight down to it in one configuration."""
        target = base @ self._down(pose, 0.0).matrix @ self._from_tcp
        above = target.copy()
        above[:3, 3] += self._settings.approach_mm * base[:3, 2]  # straight up in the base, which may be tilted
        axes = self._arm.inverse(_pose(above))
        status, _ = self._arm.status_turn(axes)
        return self._arm.inverse(_pose(target), near=axes, status=status)

    def _down(self, pose: PlanarPose, turn_deg: float) -> Frame:
        height_mm = self._recipe.thickness_mm
        return Frame(pose.x_mm, pose.y_mm, height_mm, normalize_deg(pose.a_deg + turn_deg), 0.0, 180.0)


def _same_point(one: PlanarPose, other: PlanarPose) -> bool:
    return math.hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm) < SAME_MM


def _shifted(pose: PlanarPose, shift_mm: tuple[float, float]) -> PlanarPose:
    return PlanarPose(pose.x_mm + shift_mm[0], pose.y_mm + shift_mm[1], pose.a_deg)


def _turned(pose: PlanarPose, turn_deg: float) -> PlanarPose:
    return PlanarPose(pose.x_mm, pose.y_mm, pose.a_deg + turn_deg)


def _turns(angle_deg: float, low_deg: float, high_deg: float) -> list[float]:
    """Return the angle with every number of whole turns that the limits allow."""
    first = math.ceil((low_deg - angle_deg) / 360.0)
    last = math.floor((high_deg - angle_deg) / 360.0)
    return [angle_deg + 360.0 * k for k in range(first, last + 1)]


def _pose(matrix: Matrix) -> Pose:
    rows: list[list[float]] = matrix.tolist()
    return Pose(
        (rows[0][3], rows[1][3], rows[2][3]),
        (
            (rows[0][0], rows[0][1], rows[0][2]),
            (rows[1][0], rows[1][1], rows[1][2]),
            (rows[2][0], rows[2][1], rows[2][2]),
        ),
    )
