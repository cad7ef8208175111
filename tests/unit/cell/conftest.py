"""A cell with a scripted camera and scripted eyes, and a robot that asks it directly."""

import itertools
from collections.abc import AsyncIterator, Callable, Collection
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.events import ResultMoved
from slabcell.cell.ledger import Ledger
from slabcell.cell.records import OfferState, PlacementRecord
from slabcell.cell.retention import Retention
from slabcell.cell.settings import CellSettings
from slabcell.geometry import PlanarPose, Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Template
from slabcell.vision.result import ImagePose, LocatedPart, LocateResult, RejectedBlob, RejectionReason, Sigma
from slabcell_drivers.camera.protocol import CameraInfo, CameraState, ImageFrame
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import AckState, Answer, Request, RequestType, RobotStatus

SLOTS = 3
PICK_BASE = Frame(200.0, -200.0, 0.0)
PLACE_BASE = Frame(220.0, 100.0, 0.0, 5.0)


def square(x: float, y: float, side: float = 30.0) -> Polygon:
    return Polygon.from_points([(x, y), (x + side, y), (x + side, y + side), (x, y + side)])


def make_recipe(slots: int = SLOTS, sha: str = "a" * 64) -> Recipe:
    return Recipe.from_template(Template("squares", tuple(square(40.0 * i, 0.0) for i in range(slots)), sha), 10.0)


def make_calibration() -> Calibration:
    lens = Lens(np.array([[400.0, 0, 32], [0, 400.0, 24], [0, 0, 1]]), np.zeros(5))
    down = np.diag([1.0, -1.0, -1.0])
    return Calibration(CameraIdentity(64, 48), lens, TablePlane(down, np.array([0.0, 0.0, 1000.0])))


def make_settings(**changes: Any) -> CellSettings:
    area = Polygon.from_points([(-30, -30), (200, -30), (200, 300), (-30, 300)])
    return CellSettings(PICK_BASE, PLACE_BASE, Frame(z_mm=260.0), area, **changes)


class ScriptedCamera:
    """Delivers grey pictures, or raises what stands next in ``script``."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.state = CameraState.READY
        self.script: list[Exception] = []
        self.snaps = 0
        self.age_s = 0.0
        self.shape = (48, 64)
        self._clock = clock

    async def open(self, timeout_s: float) -> CameraInfo:
        return CameraInfo("none", "scripted", "1", 64, 48, "Mono8")

    async def snap(self, timeout_s: float) -> ImageFrame:
        self.snaps += 1
        if self.script:
            raise self.script.pop(0)
        now = self._clock()
        return ImageFrame(np.full(self.shape, 90, np.uint8), "Mono8", self.snaps, now - self.age_s, now)

    async def close(self) -> None:
        self.state = CameraState.CLOSED


@dataclass
class ScriptedEyes:
    """Sees one part for each slot in ``on_table``, at a place that depends on the slot alone."""

    on_table: set[int] = field(default_factory=lambda: set(range(SLOTS)))
    rejected: int = 0
    far_away: set[int] = field(default_factory=set)
    lying: set[int] = field(default_factory=set)
    missing: set[int] = field(default_factory=set)
    unmeasured: set[int] = field(default_factory=set)
    offset_mm: float = 0.01
    problem: Exception | None = None
    asked: list[tuple[int, ...]] = field(default_factory=list)
    measured: list[tuple[int, ...]] = field(default_factory=list)

    def locate(self, image: Any, *, area_mm: Polygon, free_slots: Collection[int]) -> LocateResult:
        if self.problem is not None:
            raise self.problem
        self.asked.append(tuple(free_slots))
        parts = tuple(self._part(slot) for slot in sorted(self.on_table & set(free_slots)))
        blob = RejectedBlob(1.0, 2.0, 3.0, RejectionReason.NO_SLOT_FITS, "nothing like it", np.zeros((0, 2)))
        empty = tuple(sorted(set(free_slots) - self.on_table))
        return LocateResult(parts, (blob,) * self.rejected, empty, {"segment": 1.0, "match": 0.5, "total": 1.5})

    def _part(self, slot: int) -> LocatedPart:
        y = 2000.0 if slot in self.far_away else 40.0 * slot
        pick = PlanarPose(50.0, min(y, 290.0), 10.0 * slot)
        place = PlanarPose(40.0 * slot + 15.0, 5000.0 if slot in self.far_away else 15.0, 0.0)
        zero = np.zeros((0, 2))
        image = ImagePose(1.0, 1.0, 0.0)
        motion = RigidTransform2D(-pick.a_deg, 0.0, 0.0)
        return LocatedPart(slot, 0.9, 0.1, 4, image, motion, pick, place, Sigma(0.01, 0.01, 0.01), zero)

    def measure(
        self, image: Any, *, assembly_in_table: RigidTransform2D, slots: Collection[int]
    ) -> tuple[PlacementRecord, ...]:
        if self.problem is not None:
            raise self.problem
        self.measured.append(tuple(slots))
        offsets = {slot: float("nan") if slot in self.unmeasured else self.offset_mm for slot in slots}
        return tuple(
            PlacementRecord(slot, slot in self.lying - self.missing, offsets[slot], 0.0, 0.0, 0.02)
            for slot in sorted(slots)
        )


class ScriptedRobot:
    """Asks a cell directly; counts its own sequence, and remembers its last result as a robot does."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        self.session = 0
        self.sequence = 0
        self.result_id = 0
        self.ack = AckState.NONE
        self.holds = False
        self.job_id = 0

    def request(self, kind: RequestType, **values: Any) -> Request:
        self.sequence += 1
        known: dict[str, Any] = {
            "session": 0 if kind is RequestType.HELLO else self.session,
            "sequence": self.sequence,
            "job_id": self.job_id,
            "ack_result_id": self.result_id,
            "ack_state": self.ack,
            "status": RobotStatus(mode=4, gripper_holds_part=self.holds),
        }
        return Request(kind, **{**known, **values})

    async def ask(self, kind: RequestType, **values: Any) -> Answer:
        answer = await self.cell.handle(self.request(kind, **values))
        await self.cell.settled()
        return answer

    async def hello(self) -> Answer:
        answer = await self.ask(RequestType.HELLO)
        self.session = answer.session
        return answer

    async def trigger(self) -> Answer:
        return await self.ask(RequestType.TRIGGER)

    async def next(self) -> Answer:
        return await self.ask(RequestType.NEXT)

    async def say(self, state: AckState, result_id: int | None = None) -> Answer:
        if result_id is not None:
            self.result_id = result_id
        self.ack = state
        if state is AckState.GRASPED:
            self.holds = True
        elif state is AckState.PLACED:
            self.holds = False
        return await self.ask(RequestType.ACK)

    async def lay(self, result_id: int) -> Answer:
        """Accept, grasp and place a result; return the last answer."""
        await self.say(AckState.ACCEPTED, result_id)
        await self.say(AckState.GRASPED)
        return await self.say(AckState.PLACED)

    async def lay_all(self) -> Answer:
        """Trigger and lay until the cell has no more; return the answer to the last trigger."""
        while True:
            triggered = await self.trigger()
            if triggered.code != 0 or triggered.left == 0:
                return triggered
            left = triggered.left
            while left:
                offered = await self.next()
                assert offered.offer is not None
                left = (await self.lay(offered.offer.result_id)).left


class Bench:
    """Everything of one cell; ``restart`` ends it as a power cut does and starts another on the same ledger."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.now_s = 100.0
        self.camera = ScriptedCamera(self.clock)
        self.eyes = ScriptedEyes()
        self.settings = make_settings()
        self.recipe = make_recipe()
        self.calibration: Calibration | None = make_calibration()
        self.bundles = False
        self.retention: Retention | None = None
        self.utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)
        self.events: list[Any] = []

    def clock(self) -> float:
        self.now_s += 0.001
        return self.now_s

    async def start(self) -> None:
        self.ledger = await Ledger.open(
            self.folder / "ledger.sqlite", now=lambda: self.utc_now().isoformat(timespec="milliseconds")
        )
        self.cell = Cell(
            self.camera,
            self.calibration,
            self.recipe,
            arm=KR3_R540,
            settings=self.settings,
            ledger=self.ledger,
            bundles=BundleWriter(self.folder / "bundles", retention=self.retention, now=self.utc_now)
            if self.bundles
            else None,
            eyes=self.eyes if self.calibration else None,
            clock=self.clock,
        )
        self.cell.subscribe(self.events.append)
        self.cell.subscribe(self.lay)
        self.robot = ScriptedRobot(self.cell)
        await self.cell.start()

    def lay(self, event: Any) -> None:
        """Let the eyes see what the robot has laid."""
        if isinstance(event, ResultMoved) and event.offer.state is OfferState.PLACED:
            self.eyes.lying.add(event.offer.slot)

    async def stop(self) -> None:
        await self.cell.stop()
        await self.ledger.close()

    async def restart(self) -> None:
        robot = self.robot
        await self.ledger.close()  # what is in the file now is all there is: stop() can write nothing any more
        await self.cell.stop()
        await self.start()
        for name in ("sequence", "result_id", "ack", "holds", "job_id"):
            setattr(self.robot, name, getattr(robot, name))

    async def states(self) -> dict[int, str]:
        """Return the state of every result of the ledger by its id."""
        rows = await self.ledger.run(lambda book: book.rows("offers"))
        return {int(str(row["result_id"])): str(row["state"]) for row in rows}


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    bench = Bench(tmp_path)
    await bench.start()
    yield bench
    await bench.stop()


@pytest.fixture
def make_bench(tmp_path: Path) -> Callable[[], Bench]:
    """Make benches that are not started yet, each in a folder of its own."""
    numbers = itertools.count()

    def make() -> Bench:
        folder = tmp_path / str(next(numbers))
        folder.mkdir()
        return Bench(folder)

    return make
