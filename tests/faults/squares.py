"""A cell that lays four squares: real cell and ledger, scripted camera and eyes, and how a job is judged afterwards."""

import asyncio
import contextlib
import math
from collections.abc import AsyncGenerator, Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.catalogue import Fault, entry
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.records import OfferState, PlacementRecord
from slabcell.cell.settings import CellSettings
from slabcell.geometry import PlanarPose, Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Template
from slabcell.vision.result import ImagePose, LocatedPart, LocateResult, Sigma
from slabcell_drivers.camera.protocol import CameraInfo, CameraState, ImageFrame
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.frame import Frame

SLOTS = 4
THICKNESS_MM = 10.0
TOOL = Frame(z_mm=260.0)
PICK_BASE = Frame(200.0, -200.0, 0.0, 1.5)
PLACE_BASE = Frame(220.0, 60.0, 0.0, -2.0)
COMPLETE = "Job complete: every slot is filled"
ENDINGS = (COMPLETE, entry(Fault.NOTHING_FOUND).robot, entry(Fault.NO_MATCH).robot)


def square(x: float, y: float) -> Polygon:
    return Polygon.from_points([(x, y), (x + 30.0, y), (x + 30.0, y + 30.0), (x, y + 30.0)])


RECIPE = Recipe.from_template(
    Template("squares", tuple(square(40.0 * i, 0.0) for i in range(SLOTS)), "a" * 64), THICKNESS_MM
)
SLOT_POSES = [Frame(40.0 * i + 15.0, 15.0, THICKNESS_MM, 0.0, 0.0, 180.0) for i in range(SLOTS)]
TABLE_POSES = [Frame(50.0, 40.0 * i, THICKNESS_MM, 10.0 * i, 0.0, 180.0) for i in range(SLOTS)]


class World:
    """Slabs, one for each slot, and a gripper; also what the eyes see of them."""

    def __init__(self) -> None:
        self.slabs = [PICK_BASE @ pose for pose in TABLE_POSES]
        self.held: int | None = None
        self.picks: list[int] = []
        self.empty_grips = 0
        self.picked_out_of_a_slot = 0

    @property
    def vacuum(self) -> bool:
        """Whether the cup holds a slab."""
        return self.held is not None

    def grip(self, tcp: Frame) -> bool:
        if self.held is None:
            near = [i for i, slab in enumerate(self.slabs) if distance(slab, tcp) < 1.0]
            if not near:
                self.empty_grips += 1
                return False
            self.picked_out_of_a_slot += self.lies_in_slot(near[0])
            self.held = near[0]
            self.picks.append(near[0])
        return True

    def release(self, tcp: Frame) -> None:
        if self.held is not None:
            # dropped in the air only into the operator's hand, who lays it back to where it came from
            laid = distance(tcp, PLACE_BASE @ SLOT_POSES[self.held]) < 1.0
            self.slabs[self.held] = tcp if laid else PICK_BASE @ TABLE_POSES[self.held]
            self.held = None

    def moved(self, tcp: Frame) -> None:
        if self.held is not None:
            self.slabs[self.held] = tcp

    def lies_in_slot(self, slab: int) -> bool:
        return self.held != slab and distance(self.slabs[slab], PLACE_BASE @ SLOT_POSES[slab]) < 0.05

    def lies_on_table(self, slab: int) -> bool:
        return self.held != slab and distance(self.slabs[slab], PICK_BASE @ TABLE_POSES[slab]) < 0.05

    def locate(self, image: object, *, area_mm: Polygon, free_slots: Collection[int]) -> LocateResult:
        seen = [slot for slot in sorted(free_slots) if self.lies_on_table(slot)]
        parts = tuple(self._part(slot) for slot in seen)
        return LocateResult(parts, (), tuple(sorted(set(free_slots) - set(seen))), {"total": 1.0})

    def _part(self, slot: int) -> LocatedPart:
        pick, place = TABLE_POSES[slot], SLOT_POSES[slot]
        motion = RigidTransform2D(place.a_deg - pick.a_deg, 0.0, 0.0)
        poses = PlanarPose(pick.x_mm, pick.y_mm, pick.a_deg), PlanarPose(place.x_mm, place.y_mm, place.a_deg)
        outline = np.zeros((0, 2))
        return LocatedPart(
            slot, 0.9, 0.1, 4, ImagePose(1.0, 1.0, 0.0), motion, *poses, Sigma(0.01, 0.01, 0.01), outline
        )

    def measure(
        self, image: object, *, assembly_in_table: RigidTransform2D, slots: Collection[int]
    ) -> tuple[PlacementRecord, ...]:
        return tuple(PlacementRecord(s, self.lies_in_slot(s), 0.0, 0.0, 0.0, 0.0) for s in sorted(slots))


class GreyCamera:
    """Delivers grey pictures with honest times."""

    state = CameraState.READY
    snaps = 0

    async def open(self, timeout_s: float) -> CameraInfo:
        return CameraInfo("none", "scripted", "1", 64, 48, "Mono8")

    async def snap(self, timeout_s: float) -> ImageFrame:
        self.snaps += 1
        now = asyncio.get_running_loop().time()
        return ImageFrame(np.full((48, 64), 90, np.uint8), "Mono8", self.snaps, now, now)

    async def close(self) -> None:
        self.state = CameraState.CLOSED


def distance(one: Frame, other: Frame) -> float:
    return math.dist(one.as_tuple()[:3], other.as_tuple()[:3])


@dataclass
class Ending:
    """How a job ended, and everything needed to judge it."""

    world: World
    offers: list[tuple[int, OfferState]]
    """Slot and state of every result, in the order of the ledger."""
    texts: list[str]
    status: str
    starts: int
    log: list[str] = field(default_factory=list)


@contextlib.asynccontextmanager
async def squares_cell(folder: Path, world: World) -> AsyncGenerator[tuple[Cell, Ledger]]:
    """A cell, started, whose eyes see the world."""
    ledger = await Ledger.open(folder / "ledger.sqlite")
    lens = Lens(np.array([[400.0, 0, 32], [0, 400.0, 24], [0, 0, 1]]), np.zeros(5))
    table = TablePlane(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1000.0]))
    area = Polygon.from_points([(-30, -30), (200, -30), (200, 300), (-30, 300)])
    cell = Cell(
        GreyCamera(),
        Calibration(CameraIdentity(64, 48), lens, table),
        RECIPE,
        arm=KR3_R540,
        settings=CellSettings(PICK_BASE, PLACE_BASE, TOOL, area, attempts_per_slot=10),
        ledger=ledger,
        eyes=world,
        clock=asyncio.get_running_loop().time,
    )
    try:
        await cell.start()
        yield cell, ledger
    finally:
        await cell.stop()
        await ledger.close()


async def slots_and_states(ledger: Ledger) -> list[tuple[int, OfferState]]:
    """Slot and state of every result, in the order of the ledger."""
    rows = await ledger.run(lambda book: book.rows("offers"))
    return [(int(str(row["slot"])), OfferState(str(row["state"]))) for row in rows]


def judge(ending: Ending, description: str) -> None:
    """Check what must hold after any job, whatever happened on the cable."""
    world = ending.world
    told = f"{description}\n" + "\n".join(ending.log[-60:])
    assert world.picked_out_of_a_slot == 0, f"a slab was picked again that lay in its slot; {told}"
    assert world.empty_grips == 0, f"the robot gripped where no slab lay; {told}"
    assert world.held is None, f"a slab hangs at the gripper at the end; {told}"
    assert ending.status == "done", f"ended as {ending.status} after {ending.starts} starts; {told}"
    assert ending.texts[-1] in ENDINGS, f"ended with {ending.texts[-1]!r}; {told}"
    for slab in range(SLOTS):
        states = [state for slot, state in ending.offers if slot == slab]
        laid, placed = world.lies_in_slot(slab), states.count(OfferState.PLACED)
        assert laid or world.lies_on_table(slab), f"slab {slab} is neither in its slot nor on the table; {told}"
        assert placed == laid, f"slab {slab} {'lies' if laid else 'does not lie'} in its slot, records {states}; {told}"
        settled = {OfferState.PLACED, OfferState.FAILED, OfferState.VOID, OfferState.UNKNOWN}
        assert set(states) <= settled, f"slab {slab} is left open in the ledger: {states}; {told}"
        recorded = placed + states.count(OfferState.FAILED) + states.count(OfferState.UNKNOWN)
        taken = world.picks.count(slab)
        assert recorded >= taken, f"slab {slab} was picked {taken} times, recorded as {states}; {told}"
        if ending.texts[-1] == COMPLETE:
            assert laid, f"the job counts as complete, but slot {slab} is empty; {told}"
