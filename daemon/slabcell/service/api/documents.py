"""What do clients read?  The JSON objects of the control API, as models from which their description is made too.

Lengths are in millimetres, angles in degrees, durations in the unit that the name says; moments are UTC in ISO 8601.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = [
    "AlarmDocument",
    "AlarmHistoryDocument",
    "AlarmsDocument",
    "CycleDocument",
    "CyclesDocument",
    "Done",
    "FrameDocument",
    "JobDocument",
    "JobsDocument",
    "LedgerDocument",
    "LinkDocument",
    "OfferDocument",
    "PastAlarmDocument",
    "PlacementDocument",
    "PoseDocument",
    "RefusedDocument",
    "RobotDocument",
    "SlotsDocument",
    "StatusDocument",
]


class Document(BaseModel):
    """Base of what is sent."""

    model_config = ConfigDict(frozen=True, populate_by_name=True)


class Done(Document):
    """A write was carried out."""

    schema_: Literal["slabcell.done/1"] = Field(default="slabcell.done/1", alias="schema")
    detail: str = Field(description="what was done, in words")


class LinkDocument(Document):
    """A link to a device."""

    name: str = Field(description="camera, robot, disk, or light where the cell has one")
    state: Literal["connecting", "up", "down"]
    since: str = Field(description="when it came to this state")
    age_s: float = Field(description="how long it has been in this state")
    detail: str = Field(description="who is at the other end, or why nobody is")


class PoseDocument(Document):
    """A KUKA frame."""

    x_mm: float
    y_mm: float
    z_mm: float
    a_deg: float
    b_deg: float
    c_deg: float


class RobotDocument(Document):
    """What the robot said of itself in its last request."""

    mode: str = Field(description="unknown, T1, T2, AUT or EXT")
    gripper_holds_part: bool
    error: int = Field(description="the program's own error number, 0 if there is none")
    tcp: PoseDocument = Field(description="tool centre point in the robot's root frame")
    request: str = Field(description="what it asked for last")
    age_s: float = Field(description="how long ago")


class SlotsDocument(Document):
    """The slots of a job: each is in one of these lists, or waits for a person to say what is in it."""

    total: int
    laid: list[int]
    under_way: list[int]
    free: list[int]
    given_up: list[int] = Field(description="failed too often; free again once alarm 1604 is acknowledged")
    unknown: list[int] = Field(description="nobody knows whether a slab lies there")


class JobDocument(Document):
    """One filling of a template."""

    job: int
    robot_job: int = Field(description="the number that the robot program gave it")
    recipe: str
    template_sha256: str
    state: Literal["open", "complete", "abandoned"]
    began: str
    ended: str | None
    correction_x_mm: float = Field(description="added to every place in x of the assembly, as the last job was off")
    correction_y_mm: float = Field(description="the same in y")
    slots: SlotsDocument


class JobsDocument(Document):
    """A page of jobs, the newest first."""

    schema_: Literal["slabcell.jobs/1"] = Field(default="slabcell.jobs/1", alias="schema")
    jobs: list[JobDocument]
    before: int | None = Field(description="give this as before= for the next page; null if there is none")


class OfferDocument(Document):
    """One result: what was offered to the robot, and what became of it."""

    result: int
    slot: int
    state: str = Field(description="planned, offered, accepted, grasped, placed, failed, void or unknown")
    score: float
    pick: PoseDocument = Field(description="in the pick base")
    place: PoseDocument = Field(description="in the place base")
    reason: str = ""
    fault: int = Field(default=0, description="number of the alarm that a person has to clear for it")
    changed: str | None = None


class RefusedDocument(Document):
    """A part that was located and not offered."""

    slot: int
    number: int = Field(description="in the error catalogue")
    detail: str


class PlacementDocument(Document):
    """How a laid slab lies in its slot: placed minus nominal, in the assembly frame."""

    slot: int
    found: bool
    dx_mm: float | None
    dy_mm: float | None
    da_deg: float | None
    residual_mm: float | None


class CycleDocument(Document):
    """One trigger and what came of it.  What became of the results since stands in the ledger of the job."""

    cycle: int = Field(description="number of the cycle, ascending over restarts")
    ledger_cycle: int = Field(description="its number in the ledger, 0 if nothing was offered")
    job: int
    session: int
    trigger: int = Field(description="sequence number of the trigger")
    verification: bool
    began: str
    ended: bool
    code: int = Field(description="0 results, 1 job complete, 2 nothing left, from 1000 on a number of the catalogue")
    message: str
    times_ms: dict[str, float] = Field(description="stages in their order, and total")
    found: int = Field(description="parts that the vision located")
    rejected: int = Field(description="blobs that it refused")
    refused: list[RefusedDocument]
    offers: list[OfferDocument] = Field(description="as they were when the cycle ended; now, while it runs")
    placements: list[PlacementDocument]
    frame: int | None = Field(description="id of its picture at the camera")
    bundle: str = Field(default="", description="name of the file that the cycle is kept in, empty if it is not")


class CyclesDocument(Document):
    """A page of ended cycles, the newest first."""

    schema_: Literal["slabcell.cycles/1"] = Field(default="slabcell.cycles/1", alias="schema")
    cycles: list[CycleDocument]
    before: int | None = Field(description="give this as before= for the next page; null if there is none")


class LedgerDocument(Document):
    """Every result of a job, and how its slabs were measured to lie last."""

    schema_: Literal["slabcell.job/1"] = Field(default="slabcell.job/1", alias="schema")
    job: JobDocument
    offers: list[OfferDocument]
    placements: list[PlacementDocument]


class AlarmDocument(Document):
    """An alarm that stands."""

    number: int
    title: str
    detail: str
    priority: Literal["high", "medium", "low"]
    category: str
    meaning: str
    action: str
    clears: Literal["itself", "acknowledge", "restart"]
    since: str
    age_s: float
    cause_gone: bool = Field(description="it waits for a person only")
    acknowledged_by: str = Field(description="who has seen it while its cause lasts; empty if nobody has")
    shelved_s: float = Field(description="for how long it is not shown yet; 0 if it is not shelved")
    count: int = Field(description="how often it came since the daemon started")


class AlarmsDocument(Document):
    """The alarms that stand: the most urgent first, the newest first among equals."""

    schema_: Literal["slabcell.alarms/1"] = Field(default="slabcell.alarms/1", alias="schema")
    alarms: list[AlarmDocument]


class PastAlarmDocument(Document):
    """An alarm that came, and when it went."""

    id: int
    number: int
    title: str
    detail: str
    came: str
    went: str | None
    why: str


class AlarmHistoryDocument(Document):
    """A page of alarms that came, the newest first."""

    schema_: Literal["slabcell.alarm-history/1"] = Field(default="slabcell.alarm-history/1", alias="schema")
    alarms: list[PastAlarmDocument]
    before: int | None = Field(description="give this as before= for the next page; null if there is none")


class FrameDocument(Document):
    """The newest picture, and what was found in it, in pixels of the picture (centre of the top-left pixel is 0, 0)."""

    schema_: Literal["slabcell.frame/1"] = Field(default="slabcell.frame/1", alias="schema")
    frame: str = Field(description="id of this picture")
    width: int
    height: int
    pixel_format: str
    age_s: float
    source: str = Field(description="camera, or the cycle that it was kept with")
    overlay: dict[str, Any] | None = Field(description="parts, rejected blobs and slots; null if nothing was located")


class StatusDocument(Document):
    """How the cell is."""

    schema_: Literal["slabcell.status/1"] = Field(default="slabcell.status/1", alias="schema")
    name: str
    version: str
    protocol: int = Field(description="version of the telegrams with the robot")
    pid: int
    uptime_s: float
    state: str = Field(description="slabcell's own name, sub-state included")
    opc40100: str = Field(description="the state of OPC 40100-1")
    packml: str = Field(description="the state of PackML (ISA-TR88)")
    held: str | None = Field(description="why the cell does not get on: a cause of our own")
    suspended: str | None = Field(description="why it waits: a cause outside of it")
    stepping: bool = Field(description="it halts after the next slab")
    recipe: str
    template_sha256: str
    calibration_created: str | None
    links: list[LinkDocument]
    robot: RobotDocument | None = Field(description="null until it has asked for something")
    refused_peers: int = Field(description="connections to the robot's port that were turned away since the start")
    job: JobDocument | None
    cycle: CycleDocument | None = Field(description="the present cycle, or the last one")
    alarms: int = Field(description="how many alarms are shown")
    highest_alarm: AlarmDocument | None
    event: str = Field(description="id of the last event that this status includes")
    pending_reload: list[str] = Field(description="changed keys of the configuration that need a restart")
