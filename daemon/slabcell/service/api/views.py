"""How do values of the cell become JSON objects of the API?"""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime, timedelta

from slabcell.catalogue import entry
from slabcell.cell.alarms import Alarm, Alarms
from slabcell.cell.events import CycleRecord
from slabcell.cell.records import OfferRecord, PlacementRecord
from slabcell.cell.states import CellState, HeldCause, SuspendedCause
from slabcell.service.api.documents import (
    AlarmDocument,
    CycleDocument,
    LinkDocument,
    OfferDocument,
    PlacementDocument,
    PoseDocument,
    RefusedDocument,
    RobotDocument,
)
from slabcell.service.links import Link, Links
from slabcell.service.robot_watch import RobotWatch
from slabcell_drivers.robot.frame import Frame

__all__ = [
    "alarm_view",
    "cycle_view",
    "link_view",
    "offer_view",
    "opc40100",
    "packml",
    "placement_view",
    "pose_view",
    "robot_view",
]


def link_view(links: Links, link: Link) -> LinkDocument:
    """Return how a link stands."""
    return LinkDocument(
        name=link.name.value,
        state=link.state.value,
        since=link.since_utc.isoformat(timespec="milliseconds"),
        age_s=round(links.age_s(link), 3),
        detail=link.detail,
    )


def pose_view(frame: Frame) -> PoseDocument:
    """Return a KUKA frame."""
    x, y, z, a, b, c = frame.as_tuple()
    return PoseDocument(x_mm=x, y_mm=y, z_mm=z, a_deg=a, b_deg=b, c_deg=c)


def robot_view(robot: RobotWatch) -> RobotDocument | None:
    """Return what the robot said of itself last."""
    request = robot.last
    if request is None:
        return None
    return RobotDocument(
        mode=robot.mode,
        gripper_holds_part=request.status.gripper_holds_part,
        error=request.status.error,
        tcp=pose_view(request.tcp),
        request=request.type.name.lower(),
        age_s=round(robot.age_s, 3),
    )


def alarm_view(alarms: Alarms, alarm: Alarm) -> AlarmDocument:
    """Return an alarm with the words of the catalogue."""
    words = entry(alarm.fault)
    now_s = time.monotonic()
    age_s = max(0.0, now_s - alarm.came_s)
    return AlarmDocument(
        number=int(alarm.fault),
        title=words.title,
        detail=alarm.detail,
        priority=words.priority.value,
        category=words.category,
        meaning=words.meaning,
        action=words.action,
        clears=words.clears.value,
        since=(datetime.now(UTC) - timedelta(seconds=age_s)).isoformat(timespec="milliseconds"),
        age_s=round(age_s, 3),
        cause_gone=alarm.cause_gone,
        acknowledged_by=alarm.acknowledged_by,
        shelved_s=round(max(0.0, (alarm.shelved_until_s or 0.0) - now_s), 3),
        count=alarms.counts[alarm.fault],
    )


def offer_view(offer: OfferRecord, changed: str | None = None) -> OfferDocument:
    """Return a result."""
    return OfferDocument(
        result=offer.result_id,
        slot=offer.slot,
        state=offer.state.value,
        score=round(offer.score, 4),
        pick=pose_view(offer.pick),
        place=pose_view(offer.place),
        reason=offer.reason,
        fault=offer.fault,
        changed=changed,
    )


def placement_view(placement: PlacementRecord) -> PlacementDocument:
    """Return how a slab lies; what could not be measured is null, because JSON knows no NaN."""

    def number(value: float) -> float | None:
        return round(value, 4) if math.isfinite(value) else None

    return PlacementDocument(
        slot=placement.slot,
        found=placement.found,
        dx_mm=number(placement.dx_mm),
        dy_mm=number(placement.dy_mm),
        da_deg=number(placement.da_deg),
        residual_mm=number(placement.residual_mm),
    )


def cycle_view(cycle: CycleRecord, *, ended: bool, bundle: str = "") -> CycleDocument:
    """Return a cycle."""
    return CycleDocument(
        cycle=cycle.number,
        ledger_cycle=cycle.cycle_id,
        job=cycle.job_id,
        session=cycle.session,
        trigger=cycle.trigger_sequence,
        verification=cycle.verification,
        began=cycle.began_utc,
        ended=ended,
        code=cycle.code,
        message=cycle.message,
        times_ms={stage: round(value, 3) for stage, value in cycle.times_ms.items()},
        found=len(cycle.result.parts) if cycle.result else 0,
        rejected=len(cycle.result.rejected) if cycle.result else 0,
        refused=[RefusedDocument(slot=item.slot, number=int(item.fault), detail=item.detail) for item in cycle.refused],
        offers=[offer_view(offer) for offer in cycle.offers],
        placements=[placement_view(item) for item in cycle.placements],
        frame=cycle.frame_id,
        bundle=bundle,
    )


_OPC = {
    CellState.PREOPERATIONAL: "Preoperational",
    CellState.HALTED: "Halted",
    CellState.ERROR: "Error",
    CellState.INITIALIZED: "Initialized",
    CellState.READY: "Ready",
}


def opc40100(state: CellState) -> str:
    """Return the state of OPC 40100-1; every sub-state of an execution is SingleExecution there."""
    return _OPC.get(state, "SingleExecution")


def packml(state: CellState, held: HeldCause | None, suspended: SuspendedCause | None) -> str:
    """Return the state of PackML (ISA-TR88.00.02)."""
    match state:
        case CellState.PREOPERATIONAL:
            return "Resetting"
        case CellState.HALTED:
            return "Stopped"
        case CellState.ERROR:
            return "Aborted"
        case CellState.INITIALIZED:
            return "Idle"
        case CellState.VERIFYING:
            return "Completing"
        case _ if held is not None:
            return "Held"
        case _ if suspended is not None:
            return "Suspended"
        case CellState.READY:
            return "Idle"
        case _:
            return "Execute"
