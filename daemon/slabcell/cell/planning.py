"""Which parts can the robot lay, in which order, and with which poses?  Between the vision and the ledger.

Both poses of a pair are the tool centre point with its Z axis down (B 0, C 180).  The tool's own direction is free, as
long as it is the same on the part at both ends: it is chosen so that the arm reaches both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from slabcell.catalogue import Fault
from slabcell.cell.records import Pair
from slabcell.cell.settings import CellSettings
from slabcell.geometry import PlanarPose, normalize_deg
from slabcell.vision.result import LocatedPart
from slabcell_drivers.robot.arm import ArmError, ArmModel
from slabcell_drivers.robot.frame import Frame

__all__ = ["Plan", "Refusal", "plan"]

TOOL_TURNS_DEG = (0.0, 180.0, 90.0, -90.0, 45.0, -45.0, 135.0, -135.0)
"""Directions of the tool on the part that are tried, the plainest first."""


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


def plan(parts: Sequence[LocatedPart], thickness_mm: float, settings: CellSettings, arm: ArmModel) -> Plan:
    """Return what can be done with the located parts."""
    pairs: list[Pair] = []
    refused: list[Refusal] = []
    for part in sorted(parts, key=lambda item: item.slot):
        if not settings.pick_area.shape.covers(shapely.Point(part.pick.x_mm, part.pick.y_mm)):
            where = f"X {part.pick.x_mm:.1f} Y {part.pick.y_mm:.1f} of the table"
            refused.append(Refusal(part.slot, Fault.OUTSIDE_WORKSPACE, f"the grasp point at {where} is outside"))
            continue
        outcome = _reach(part, thickness_mm, settings, arm)
        if isinstance(outcome, Pair):
            pairs.append(outcome)
        else:
            refused.append(outcome)
    return Plan(tuple(pairs), tuple(refused))


def _reach(part: LocatedPart, thickness_mm: float, settings: CellSettings, arm: ArmModel) -> Pair | Refusal:
    problem = ""
    for turn_deg in TOOL_TURNS_DEG:
        pick = _downward(part.pick, thickness_mm, turn_deg)
        place = _downward(part.place, thickness_mm, turn_deg)
        try:
            _check(settings.pick_base, pick, settings, arm)
            _check(settings.place_base, place, settings, arm)
        except ArmError as error:
            problem = problem or str(error)
            continue
        return Pair(part.slot, pick, place, part.score)
    return Refusal(part.slot, Fault.UNREACHABLE, problem)


def _downward(pose: PlanarPose, height_mm: float, turn_deg: float) -> Frame:
    return Frame(pose.x_mm, pose.y_mm, height_mm, normalize_deg(pose.a_deg + turn_deg), 0.0, 180.0)


def _check(base: Frame, pose: Frame, settings: CellSettings, arm: ArmModel) -> None:
    """Raise ArmError unless the arm reaches the pose and the point above it without changing its configuration."""
    target = (base @ pose @ settings.tool.inverse()).matrix
    above = target.copy()
    # Straight up in the base: a base may be tilted against the robot's root.
    above[:3, 3] += settings.approach_mm * (base.matrix[:3, :3] @ np.array([0.0, 0.0, 1.0]))
    axes = arm.inverse(Frame.from_matrix(above))
    status, _ = arm.status_turn(axes)
    arm.inverse(Frame.from_matrix(target), near=axes, status=status)
