"""Which parts can the robot lay, in which order, and with which poses?  Between the vision and the ledger.

Both poses of a pair are the tool centre point with its Z axis down (B 0, C 180).  The direction of a round tool is
free, as long as it is the same on the part at both ends, and a part that looks alike after a turn may be laid turned:
both are chosen so that the wrist turns least.  Slabs of one thickness never hinder a tool that touches their upper
faces; of several, `clearance` says which have to come first.  A picture from above knows no heights of anything else:
what may stand in the way has to be a forbidden zone.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import product

from slabcell.catalogue import Fault
from slabcell.cell.clearance import Clearance
from slabcell.cell.descent import Descent, DescentTo
from slabcell.cell.laying import LayingOrder
from slabcell.cell.records import Pair
from slabcell.cell.settings import CellSettings
from slabcell.cell.workspace import Refusal, Workspace
from slabcell.cell.wrist import least_turn
from slabcell.geometry import PlanarPose, normalize_deg
from slabcell.recipe import Recipe
from slabcell.vision.result import LocatedPart
from slabcell_drivers.robot.arm import ArmError, ArmModel, Axes
from slabcell_drivers.robot.frame import Frame

__all__ = ["Plan", "Planner", "Refusal"]

TOOL_TURNS_DEG = tuple(float(angle) for angle in range(-150, 181, 30))
"""Directions of the tool on the part that are considered."""

FEW_TURNS_DEG = (0.0, 180.0, 90.0, -90.0)
"""The same where each costs an inverse kinematics."""

STRAIGHT_MM, STRAIGHT_DEG = 1e-3, 1e-3
"""A tool whose axis is the flange's within this only turns A6 when it turns."""

SAME_MM = 1e-6
PLACES_REMEMBERED = 4096


@dataclass(frozen=True)
class Plan:
    """What can be laid, in the order in which it shall be, and what is left out.

    How much that is, is known at once.  In which direction the tool takes each slab is chosen when `pairs` are asked
    for first, by whatever thread: the robot can be told the number meanwhile.
    """

    count: int
    refused: tuple[Refusal, ...]
    choose: Callable[[], tuple[Pair, ...]]

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """The poses, ``count`` pairs of them."""
        return self.choose()


@dataclass(frozen=True, slots=True)
class _Reached:
    """A part that can be laid: where A6 stands at its pick, and the ways to lay it, each with A6; tool unturned."""

    part: LocatedPart
    a6_deg: float
    ways: list[tuple[float, PlanarPose]]


class Planner:
    """Plans for one product in one cell; what does not change from picture to picture is computed once."""

    def __init__(self, recipe: Recipe, settings: CellSettings, arm: ArmModel) -> None:
        self._recipe = recipe
        self._settings = settings
        self._arm = arm
        self._order = LayingOrder(recipe.template.slots)
        self._workspace = Workspace(recipe.template.slots, settings)
        self._clearance = Clearance(recipe, settings)
        self._to_pick = DescentTo(settings.pick_base, settings.tool, settings.approach_mm, arm)
        self._to_place = DescentTo(settings.place_base, settings.tool, settings.approach_mm, arm)
        x, y, _, _, b, c = settings.tool.as_tuple()
        # Several cups, or one beside the tool's axis, stand on the slab as the vision has chosen, and in no other way.
        free = list(recipe.grasp.cups_mm) == [(0.0, 0.0)]
        self._turns_deg = TOOL_TURNS_DEG if free else (0.0,)
        self._few_turns_deg = FEW_TURNS_DEG if free else (0.0,)
        self._straight = math.hypot(x, y) < STRAIGHT_MM and math.hypot(b, c) < STRAIGHT_DEG
        # A slot is filled at the same point of the assembly every time: the arm is asked once.
        self._place_axes = lru_cache(PLACES_REMEMBERED)(self._at_place)
        self._ways = lru_cache(PLACES_REMEMBERED)(self._find_ways)
        self._middles = [(float(x), float(y)) for x, y in (slot.centroid for slot in recipe.template.slots)]

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
            parts = [part._replace(place=_shifted(part.place, correction_mm)) for part in parts]
        refused: list[Refusal] = []
        possible: dict[int, LocatedPart] = {}
        in_order = sorted(parts, key=lambda item: item.slot)
        for part, problem in zip(in_order, self._workspace.refusals(in_order), strict=True):
            if problem is None:
                possible[part.slot] = part
            else:
                refused.append(problem)
        after = self._restrict(possible, laid, refused)
        reached: list[_Reached | Pair] = []
        done = set(laid)
        order = self._order.order(possible, laid, after)
        # The arm stays in the configuration that reaches the first slab, where it can.  Which is the first is known
        # beforehand only where none has to wait for another.
        quick, usual = self._quickly([possible[slot] for slot in order]) if not after else ({}, None)
        for slot in order:
            if after and not done.issuperset(after.get(slot, ())):
                continue  # what had to come before it could not be reached: said below
            try:
                if self._straight:
                    part = possible[slot]
                    at_pick = quick.get(slot) or self._at_pick(part, usual)
                    if usual is None:
                        usual = self._arm.status_turn(at_pick)[0]
                        quick, _ = self._quickly([possible[item] for item in order], usual)
                    ways = self._ways(slot, part.place, part.symmetry_order, correction_mm, usual)
                    reached.append(_Reached(part, at_pick[5], ways))
                else:
                    reached.append(self._first_reached(possible[slot], correction_mm))
            except ArmError as error:
                refused.append(Refusal(slot, Fault.UNREACHABLE, str(error)))
                continue
            done.add(slot)
        for slot in possible.keys() - done - {item.slot for item in refused}:
            first = ", ".join(str(other) for other in sorted(set(after.get(slot, ())) - done))
            detail = f"the slabs of slots {first} have to go first: the gripper would hit what is higher than it"
            refused.append(Refusal(slot, Fault.COLLISION, detail))
        refused.sort(key=lambda item: item.slot)
        return Plan(len(reached), tuple(refused), partial(self._choose, reached))

    def _choose(self, reached: Sequence[_Reached | Pair]) -> tuple[Pair, ...]:
        """Return the poses such that the wrist turns least on the way through all of them."""
        limits = self._arm.axis_min_deg[5], self._arm.axis_max_deg[5]
        pairs: list[Pair] = []
        wrist_deg: float | None = None
        for item in reached:
            if isinstance(item, Pair):
                pairs.append(item)
                continue
            a6 = [a6 for a6, _ in item.ways]
            way, turn, wrist_deg = least_turn(item.a6_deg, a6, self._turns_deg, limits, wrist_deg)
            turn_deg, part = self._turns_deg[turn], item.part
            height_mm = self._recipe.height_mm(part.slot)
            place = _down(item.ways[way][1], turn_deg, height_mm)
            pairs.append(Pair(part.slot, _down(part.pick, turn_deg, height_mm), place, part.score))
        return tuple(pairs)

    def _restrict(
        self, possible: dict[int, LocatedPart], laid: Collection[int], refused: list[Refusal]
    ) -> Mapping[int, Collection[int]]:
        """Take away the parts that cannot be laid for what is higher; return what has to come before the others."""
        if self._clearance.one_height:
            return {}
        too_high = self._clearance.too_high()
        if too_high:
            refused += [Refusal(slot, Fault.COLLISION, too_high) for slot in possible]
            possible.clear()
            return {}
        while True:  # what is taken away may have been what another one waits for
            found = self._clearance.precedence(possible, laid)
            if not found.refused:
                return found.after
            refused += found.refused
            for item in found.refused:
                del possible[item.slot]

    def _quickly(
        self, parts: Sequence[LocatedPart], usual: int | None = None
    ) -> tuple[dict[int, Axes | None], int | None]:
        """Return the axes at the picks as far as one configuration gets there and that is known at once; and which."""
        if not self._straight:
            return {}, None
        poses = [(part.pick, self._recipe.height_mm(part.slot)) for part in parts]
        picks, usual = self._to_pick.quickly(poses, usual)
        return {part.slot: axes for part, axes in zip(parts, picks, strict=True)}, usual

    def _at_pick(self, part: LocatedPart, usual: int | None) -> Axes:
        return self._descend(self._to_pick(part.pick, self._recipe.height_mm(part.slot)), "pick", usual)

    def _find_ways(
        self, slot: int, place: PlanarPose, symmetry_order: int, correction_mm: tuple[float, float], usual: int
    ) -> list[tuple[float, PlanarPose]]:
        """Return the ways to lay a part that the arm reaches, each with A6; raises ArmError if there is none."""
        height_mm = self._recipe.height_mm(slot)
        found: list[tuple[float, PlanarPose]] = []
        problem: ArmError | None = None
        for alike in self._alike(slot, place, symmetry_order, correction_mm):
            if found and _same_point(found[0][1], alike):
                # Gripped in its middle: laid turned, only A6 differs, and by the turn itself.
                found.append((found[0][0] + alike.a_deg - found[0][1].a_deg, alike))
                continue
            try:
                found.append((self._at_place(alike, height_mm, usual)[5], alike))
            except ArmError as error:
                problem = problem or error
        if problem is not None and not found:
            raise problem
        return found

    def _first_reached(self, part: LocatedPart, correction_mm: tuple[float, float]) -> Pair:
        """Return the poses of one part with a tool that is bent or beside the flange's axis.  Raises ArmError."""
        problem: ArmError | None = None
        height_mm = self._recipe.height_mm(part.slot)
        places = self._alike(part.slot, part.place, part.symmetry_order, correction_mm)
        for turn, place in product(self._few_turns_deg, places):
            try:
                self._descend(self._to_pick(_turned(part.pick, turn), height_mm), "pick", None)
                self._place_axes(_turned(place, turn), height_mm, None)
            except ArmError as error:
                problem = problem or error
                continue
            pick = _down(part.pick, turn, height_mm)
            return Pair(part.slot, pick, _down(place, turn, height_mm), part.score)
        assert problem is not None  # noqa: S101  (there is at least one way, and none was reached)
        raise problem

    def _alike(
        self, slot: int, place: PlanarPose, symmetry_order: int, correction_mm: tuple[float, float]
    ) -> list[PlanarPose]:
        """Return the ways to lay the part that look the same."""
        # Beside higher slabs the gripper is where `clearance` has looked, and nowhere else.
        order = max(1, min(symmetry_order, 12)) if self._clearance.one_height else 1
        found = [place]
        middle = self._middles[slot]
        middle_x, middle_y = middle[0] + correction_mm[0], middle[1] + correction_mm[1]
        arm_x, arm_y = place.x_mm - middle_x, place.y_mm - middle_y
        for step in range(1, order):
            turn_deg = 360.0 * step / order
            c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
            x, y = middle_x + c * arm_x - s * arm_y, middle_y + s * arm_x + c * arm_y
            found.append(PlanarPose(x, y, normalize_deg(place.a_deg + turn_deg)))
        return found

    def _at_place(self, place: PlanarPose, height_mm: float, usual: int | None) -> Axes:
        return self._descend(self._to_place(place, height_mm), "place", usual)

    def _descend(self, way: Descent, end: str, usual: int | None) -> Axes:
        """Return the axes at a pose, in the ``usual`` configuration if that gets there, or in the quickest that does.

        Raises ArmError unless the arm gets straight down to it in one configuration.  The error says at which ``end``
        of the slab's way that is, pick or place.
        """
        above, at = way
        if usual is not None:
            with suppress(ArmError):  # another one may get there
                return self._arm.inverse(at, near=self._arm.inverse(above, status=usual), status=usual)
        try:
            quickest = self._arm.inverse(above)
            try:
                return self._arm.inverse(at, near=quickest, status=self._arm.status_turn(quickest)[0])
            except ArmError:
                others = [self._arm.status_turn(axes)[0] for axes in self._arm.all_solutions(above)]
                for status in dict.fromkeys(others):  # the quickest first
                    with suppress(ArmError):
                        return self._arm.inverse(at, near=self._arm.inverse(above, status=status), status=status)
                raise
        except ArmError as error:
            raise ArmError(f"{end}: {error}", error.fault) from error


def _down(pose: PlanarPose, turn_deg: float, height_mm: float) -> Frame:
    return Frame(pose.x_mm, pose.y_mm, height_mm, normalize_deg(pose.a_deg + turn_deg), 0.0, 180.0)


def _same_point(one: PlanarPose, other: PlanarPose) -> bool:
    return math.hypot(one.x_mm - other.x_mm, one.y_mm - other.y_mm) < SAME_MM


def _shifted(pose: PlanarPose, shift_mm: tuple[float, float]) -> PlanarPose:
    return PlanarPose(pose.x_mm + shift_mm[0], pose.y_mm + shift_mm[1], pose.a_deg)


def _turned(pose: PlanarPose, turn_deg: float) -> PlanarPose:
    return PlanarPose(pose.x_mm, pose.y_mm, pose.a_deg + turn_deg)
