"""Robot, link and power fail anywhere in a job: no slab is picked twice, none is lost without a record.

The shipped programs on the software KRC, over TCP, with the real cell and its ledger; camera and vision are replaced by
the truth about the table.  A seed chooses what fails and when; the short test takes fresh seeds and prints the first.

The large counts: ``python -m pytest -m slow tests/integration/test_krl_programs_faults.py``, with
``SLABCELL_FAULT_SEEDS=1000`` for the number of seeds and ``SLABCELL_FAULT_FIRST=0`` for the first one.
"""

import asyncio
import dataclasses
import itertools
import math
import os
import random
import secrets
import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from slabcell.calibration.model import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.catalogue import Fault as CellFault
from slabcell.catalogue import entry
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger, LedgerError, LedgerFile
from slabcell.cell.records import OfferRecord, OfferState, PlacementRecord
from slabcell.cell.settings import CellSettings
from slabcell.geometry import PlanarPose, Polygon, RigidTransform2D
from slabcell.recipe import Recipe
from slabcell.template import Template
from slabcell.vision.result import ImagePose, LocatedPart, LocateResult, Sigma
from slabcell_drivers.camera.protocol import CameraInfo, CameraState, ImageFrame
from slabcell_drivers.krc import SoftwareKrc, read_project
from slabcell_drivers.krc.eki_faults import Fault, LinkFaults, Way
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki import EkiServer
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.integration
KRL = Path(__file__).parents[2] / "krl"
SOURCES = read_project(KRL)
CHANNEL = (KRL / "SlabCell.xml").read_bytes()

SLABS = 3
THICKNESS_MM = 10.0
TOOL = Frame(z_mm=260.0)
PICK_BASE = Frame(190.0, -290.0, 0.0, 1.5)
PLACE_BASE = Frame(200.0, 80.0, 0.0, -1.0)
PICK_AREA = Polygon.from_points([(-30, 10), (150, 0), (232, 100), (240, 315), (-20, 322)])
START = (PlanarPose(30, 60, 20.0), PlanarPose(120, 90, -70.0), PlanarPose(70, 200, 130.0))
SLOTS = tuple(Polygon.from_points([(x, 0), (x + 35, 0), (x + 35, 35), (x, 35)]) for x in (0, 36, 72))

NORMAL_TELEGRAMS = 16
"""Telegrams each way of a job of three slabs without a fault."""
NORMAL_STATEMENTS = 3790
"""Statements of the same job."""
MAX_LIVES = 8
"""How often the robot may be started in one run of the test."""
MAX_HELPS = 10
"""How often a person helps in one run."""
MAX_WALL_S = 600.0
"""A life of the robot that hangs: far more than any takes, however busy the machine is."""


def tool_down(base, pose):
    """The frame in the root of a point on a slab's upper face, tool Z down."""
    return base @ Frame(pose.x_mm, pose.y_mm, THICKNESS_MM, pose.a_deg, 0.0, 180.0)


def slot_pose(slot):
    x, y = SLOTS[slot].centroid
    return PlanarPose(float(x), float(y), 0.0)


class Table:
    """The truth: where every slab lies, what hangs at the gripper, and how often each slab was gripped."""

    def __init__(self):
        self.slabs = [tool_down(PICK_BASE, pose) for pose in START]
        self.held = None
        self.grips = []
        self.vacuum = False
        self.krc = None
        self._grip = Frame()

    def output_changed(self, index, value, tcp):
        if index != 1:
            return
        if value:
            self.take(tcp)
        else:
            self.let_go(tcp)

    def take(self, tcp):
        self.vacuum = True
        near = [i for i, slab in enumerate(self.slabs) if math.dist(slab.as_tuple()[:3], tcp.as_tuple()[:3]) < 1.0]
        if near and self.held is None:
            self.held = near[0]
            self.grips.append((self.held, self.in_slot(self.held)))
            self._grip = tcp.inverse() @ self.slabs[self.held]
        self.krc.set_input(1, self.held is not None)

    def let_go(self, tcp):
        self.vacuum = False
        if self.held is not None:
            pose = tcp @ self._grip
            self.slabs[self.held] = Frame(pose.x_mm, pose.y_mm, THICKNESS_MM, pose.a_deg, 0.0, 180.0)  # it falls flat
            self.held = None
        if self.krc is not None:
            self.krc.set_input(1, False)

    def take_off(self):
        """A person takes the slab off the gripper and lays it back on the table."""
        if self.held is not None:
            self.slabs[self.held] = tool_down(PICK_BASE, START[self.held])
            self.held = None
            self.krc.set_input(1, False)

    def find_lost(self):
        """A person finds what neither lies in its slot nor can be seen on the table, and lays it back."""
        for slab in range(SLABS):
            if self.held != slab and not self.in_slot(slab) and self.on_pick_side(slab) is None:
                self.slabs[slab] = tool_down(PICK_BASE, START[slab])

    def moved(self, tcp):
        if self.held is not None:
            self.slabs[self.held] = tcp @ self._grip

    def in_slot(self, slab):
        nominal = tool_down(PLACE_BASE, slot_pose(slab))
        return self.held != slab and math.dist(self.slabs[slab].as_tuple()[:3], nominal.as_tuple()[:3]) < 0.5

    def on_pick_side(self, slab):
        """The slab's pose on the table, if the camera can find it there."""
        pose = PICK_BASE.inverse() @ self.slabs[slab]
        inside = PICK_AREA.shape.covers(
            Polygon.from_points(
                [(pose.x_mm - 1, pose.y_mm - 1), (pose.x_mm + 1, pose.y_mm - 1), (pose.x_mm, pose.y_mm + 1)]
            ).shape
        )
        seen = self.held != slab and inside and not self.in_slot(slab)
        return PlanarPose(pose.x_mm, pose.y_mm, pose.a_deg) if seen else None


class TrueEyes:
    """Sees what is true."""

    def __init__(self, table):
        self._table = table

    def locate(self, image, *, area_mm, free_slots):
        found = [(slot, self._table.on_pick_side(slot)) for slot in sorted(free_slots)]
        parts = tuple(self._part(slot, pose) for slot, pose in found if pose is not None)
        empty = tuple(slot for slot, pose in found if pose is None)
        return LocateResult(parts, (), empty, {"total": 0.1})

    def _part(self, slot, pick):
        place = slot_pose(slot)
        nothing = np.zeros((0, 2))
        motion = RigidTransform2D(place.a_deg - pick.a_deg, 0.0, 0.0)
        image = ImagePose(1.0, 1.0, 0.0)
        return LocatedPart(slot, 0.99, 0.01, 4, image, motion, pick, place, Sigma(0.01, 0.01, 0.01), nothing)

    def measure(self, image, *, assembly_in_table, slots):
        return tuple(PlacementRecord(s, self._table.in_slot(s), 0.0, 0.0, 0.0, 0.01) for s in sorted(slots))


class GreyCamera:
    """Delivers a picture that nobody looks at."""

    state = CameraState.READY

    def __init__(self):
        self._numbers = itertools.count(1)

    async def open(self, timeout_s):
        return CameraInfo("none", "grey", "1", 64, 48, "Mono8")

    async def snap(self, timeout_s):
        now = time.monotonic()
        return ImageFrame(np.full((48, 64), 90, np.uint8), "Mono8", next(self._numbers), now, now)

    async def close(self):
        pass


def make_cell(table, ledger):
    down = np.diag([1.0, -1.0, -1.0])
    lens = Lens(np.array([[400.0, 0, 32], [0, 400.0, 24], [0, 0, 1]]), np.zeros(5))
    calibration = Calibration(CameraIdentity(64, 48), lens, TablePlane(down, np.array([0.0, 0.0, 1000.0])))
    recipe = Recipe.from_template(Template("squares", SLOTS, "a" * 64), THICKNESS_MM)
    settings = CellSettings(PICK_BASE, PLACE_BASE, TOOL, PICK_AREA)
    return Cell(GreyCamera(), calibration, recipe, arm=KR3_R540, settings=settings, ledger=ledger, eyes=TrueEyes(table))


@dataclass
class Plan:
    """What fails in one run."""

    link: list[tuple[Way, Fault, int]] = field(default_factory=list)
    delay_s: float = 0.05
    stop_at: list[tuple[str, int]] = field(default_factory=list)
    """What stops the robot, and at which statement.

    "cancel"; "power_hold": power loss, with a valve that keeps the vacuum; "power_drop": one that lets go.
    """
    restart_at: list[int] = field(default_factory=list)
    """Telegrams, both ways counted, at which the cell is stopped and started again."""
    cut_at: list[tuple[int, str, float]] = field(default_factory=list)
    """Telegrams at which the cable is cut, and for how many seconds.

    "cut": nothing passes and nobody is told; "forget": the connection is half-open, a new one can be made.
    """

    operator: bool = False
    """Whether a person does what the messages ask for, until the job is complete."""

    @classmethod
    def of(cls, seed):
        rng = random.Random(seed)
        faults = [fault for fault in Fault if fault is not Fault.NONE]
        plan = cls(delay_s=rng.choice([0.01, 0.05, 0.3]))
        plan.link = [
            (rng.choice(list(Way)), rng.choice(faults), rng.randrange(NORMAL_TELEGRAMS))
            for _ in range(rng.randrange(4))
        ]
        kinds = ["cancel", "power_hold", "power_drop"]
        plan.stop_at = [(rng.choice(kinds), rng.randrange(1, NORMAL_STATEMENTS)) for _ in range(rng.randrange(3))]
        plan.restart_at = sorted(rng.sample(range(2 * NORMAL_TELEGRAMS), rng.choice([0, 0, 0, 1, 2])))
        plan.cut_at = sorted(
            (rng.randrange(2 * NORMAL_TELEGRAMS), rng.choice(["cut", "forget"]), rng.choice([0.05, 0.4]))
            for _ in range(rng.choice([0, 0, 0, 1]))
        )
        plan.operator = rng.random() < 0.5
        return plan


@dataclass
class Outcome:
    """How a run ended."""

    ended: str
    messages: list[str]
    table: Table
    offers: list
    job_state: str
    operator: bool = False


class Run:
    """One job with one plan of faults."""

    def __init__(self, plan, folder, seed):
        self.plan = plan
        self.table = Table()
        self.folder = folder
        self.seed = seed
        self.cable = LinkFaults(random.Random(seed))
        self.cable.delay_s = plan.delay_s
        for way, fault, after in plan.link:
            self.cable.plan(way, fault, after=after)
        self.stops = sorted(plan.stop_at, key=lambda stop: stop[1])
        self.statements = 0
        self.telegrams = 0
        self.helps = 0
        self.loop = asyncio.get_running_loop()
        self.cell = None
        self.messages = []

    async def __call__(self):
        """Let the robot live, and start the cell again where the plan says so."""
        port, restarts, cuts = 0, list(self.plan.restart_at), list(self.plan.cut_at)
        robot = None
        while robot is None or not robot.done():
            ledger = await Ledger.open(self.folder / "ledger.sqlite")
            cell = self.cell = make_cell(self.table, ledger)
            over = asyncio.Event()

            def count(*_, over=over):
                self.telegrams += 1
                if restarts and self.telegrams >= restarts[0]:
                    over.set()
                if cuts and self.telegrams >= cuts[0][0]:
                    _, how, for_s = cuts.pop(0)
                    self.cable.forget() if how == "forget" else self.cable.cut()
                    asyncio.get_running_loop().call_later(for_s, self.cable.repair)

            link = EkiServer("127.0.0.1", port, on_telegram=count)
            try:
                await cell.start()
                await link.start(cell.handle)
                port = link.address[1]
                robot = robot or asyncio.ensure_future(asyncio.to_thread(self.robot_lives, link.address))
                waiting = asyncio.ensure_future(over.wait())
                await asyncio.wait({robot, waiting}, return_when=asyncio.FIRST_COMPLETED)
                waiting.cancel()
                del restarts[:1]
            finally:
                await link.stop()
                await cell.stop()
                await ledger.close()
        ended = await robot
        self.cable.close()
        book = LedgerFile(self.folder / "ledger.sqlite")
        jobs = book.rows("jobs")
        offers = [offer for job in jobs for offer in book.offers(job["job_id"])]
        book.close()
        # A program that is started again after the job is complete begins another job, for which nothing is left.
        states = [str(job["state"]) for job in jobs]
        state = "complete" if "complete" in states else (states or ["none"])[-1]
        return Outcome(ended, self.messages, self.table, offers, state, operator=self.plan.operator)

    def operator_helps(self, krc):
        """Do what the message on the SmartPAD asks for; return whether START shall be pressed."""
        number = int(krc.messages[-1].text[:4]) if krc.messages[-1].text[:4].isdigit() else 0
        if number in {CellFault.GRIPPER_NOT_EMPTY, CellFault.TAKE_SLAB_OFF}:
            self.table.take_off()
        if not self.plan.operator:
            return number == CellFault.TAKE_SLAB_OFF
        if number in {CellFault.PART_LOST, CellFault.PLACEMENT_UNKNOWN}:
            self.table.find_lost()
            for result_id, slot in self.ask_cell(self.unknown):
                self.ask_cell(lambda r=result_id, s=slot: self.cell.resolve(r, placed=self.table.in_slot(s)))
        return True

    async def unknown(self):
        return [(offer.result_id, offer.slot) for offer in await self.cell._desk.unknown()]

    def ask_cell(self, question):
        """Ask the cell that runs; one that is just being started again is asked once more, as a person would."""
        for _ in range(100):
            try:
                return asyncio.run_coroutine_threadsafe(question(), self.loop).result(30)
            except LedgerError:
                time.sleep(0.1)
        raise AssertionError("the cell does not come back")

    def robot_lives(self, address):
        """Start the robot, and start it again after each failure, as an operator does."""
        krc = SoftwareKrc(
            SOURCES,
            robot=KR3_R540,
            eki_configs={"SlabCell": CHANNEL},
            eki_addresses={"SlabCell": address},
            eki_link=self.cable,
            io=self.table,
            trace=self.statement,
            trace_kinds=frozenset({"statement"}),
            seed=self.seed,
        )
        self.table.krc = krc
        for name, value in {
            "TOOL_DATA[1]": TOOL,
            "BASE_DATA[1]": PICK_BASE,
            "BASE_DATA[2]": PLACE_BASE,
            "VT_TMOANSWER": 200,
            "VT_TMOTRIGGER": 600,
            "VT_OPENTRIES": 20000,
        }.items():
            krc.set_data("", name, value)
        with krc:
            for _ in range(MAX_LIVES):
                result = krc.run("SlabCell", max_wall_s=MAX_WALL_S)
                while result.status == "halted" and self.helps < MAX_HELPS and self.operator_helps(krc):
                    self.helps += 1
                    result = krc.go_on(max_wall_s=MAX_WALL_S)
                if result.status not in {"cancelled", "power_lost"}:
                    break
            self.messages = [message.text for message in krc.messages]
        return result.status

    def statement(self, _event):
        self.statements += 1
        if not self.stops or self.statements < self.stops[0][1]:
            return
        kind, _ = self.stops.pop(0)
        if kind == "cancel":
            self.table.krc.cancel()
            return
        self.table.krc.power_loss(outputs_hold=kind == "power_hold")
        if kind == "power_drop":
            self.table.let_go(self.table.krc.tcp)


CATALOGUE_TEXTS = {entry(fault).robot for fault in CellFault}


def judge(outcome):
    """Return what is wrong, or nothing."""
    wrong = []
    table = outcome.table
    for slab, was_in_slot in table.grips:
        if was_in_slot:
            wrong.append(f"slab {slab} was picked out of its slot")
    placed = {offer.slot for offer in outcome.offers if offer.state is OfferState.PLACED}
    recorded = {
        offer.slot
        for offer in outcome.offers
        if offer.state in {OfferState.FAILED, OfferState.UNKNOWN, OfferState.GRASPED, OfferState.ACCEPTED}
    }
    for slab in range(SLABS):
        laid = table.in_slot(slab)
        untouched = slab not in {gripped for gripped, _ in table.grips}
        if slab in placed and not laid:
            wrong.append(f"slab {slab} is placed in the ledger, but lies elsewhere")
        if not laid and not untouched and slab not in recorded and table.on_pick_side(slab) is None:
            wrong.append(f"slab {slab} is lost, and the ledger does not say so")
        if laid and slab not in placed | recorded:
            wrong.append(f"slab {slab} is laid, and the ledger does not know of it")
    counts = [slab for slab, _ in table.grips]
    for slab in range(SLABS):
        settled = [
            o
            for o in outcome.offers
            if o.slot == slab and o.state in {OfferState.FAILED, OfferState.VOID, OfferState.UNKNOWN}
        ]
        if counts.count(slab) > 1 + len(settled):
            wrong.append(f"slab {slab} was gripped {counts.count(slab)} times for {len(settled)} results given up")
    if outcome.operator and (outcome.ended, outcome.job_state) != ("done", "complete"):
        wrong.append(f"a person did all that was asked for, and the job is {outcome.job_state}, {outcome.ended}")
    if outcome.ended == "done":
        if outcome.job_state == "complete" and not all(table.in_slot(slab) for slab in range(SLABS)):
            wrong.append("the job is complete, but not every slab lies in its slot")
        if outcome.job_state != "complete" and (outcome.messages or [""])[-1] not in CATALOGUE_TEXTS:
            wrong.append(f"the program ended, but the job is {outcome.job_state}")
    elif outcome.ended == "halted":
        last = outcome.messages[-1] if outcome.messages else ""
        if last not in CATALOGUE_TEXTS:
            wrong.append(f"stopped without a named error: {last!r}")
    else:
        wrong.append(f"ended as {outcome.ended}: {outcome.messages[-3:]}")
    return wrong


async def trial(plan, folder, seed=0):
    return await Run(plan, folder, seed)()


async def test_without_a_fault_the_job_is_complete(tmp_path):
    outcome = await trial(Plan(), tmp_path)
    assert judge(outcome) == []
    assert outcome.job_state == "complete"
    assert sorted(outcome.table.grips) == [(slab, False) for slab in range(SLABS)]


def outcome_with(**changes):
    """What is left of a job in which slab 0 was laid, and the ledger says so."""
    table = Table()
    table.slabs[0] = tool_down(PLACE_BASE, slot_pose(0))
    table.grips = [(0, False)]
    offer = OfferRecord(1, 1, 1, 0, 0, OfferState.PLACED, 1.0, Frame(), Frame(), "")
    return dataclasses.replace(Outcome("halted", [entry(CellFault.PART_LOST).robot], table, [offer], "open"), **changes)


def test_the_judge_sees_a_slab_that_is_lost_laid_twice_or_not_where_the_ledger_says():
    assert judge(outcome_with()) == []
    lost = outcome_with(offers=[])
    lost.table.slabs[0] = Frame(0.0, 0.0, THICKNESS_MM)
    assert judge(lost) == ["slab 0 is lost, and the ledger does not say so"]
    elsewhere = outcome_with()
    elsewhere.table.slabs[0] = Frame(0.0, 0.0, THICKNESS_MM)
    assert judge(elsewhere)[0] == "slab 0 is placed in the ledger, but lies elsewhere"
    assert judge(outcome_with(offers=[])) == ["slab 0 is laid, and the ledger does not know of it"]
    twice = outcome_with()
    twice.table.grips = [(0, False), (0, True)]
    assert judge(twice) == ["slab 0 was picked out of its slot", "slab 0 was gripped 2 times for 0 results given up"]
    assert judge(outcome_with(messages=["Something odd"])) == ["stopped without a named error: 'Something odd'"]
    assert judge(outcome_with(ended="done", messages=["Something odd"])) == ["the program ended, but the job is open"]
    assert judge(outcome_with(ended="done", job_state="complete")) == [
        "the job is complete, but not every slab lies in its slot"
    ]


async def assert_survived(plans, tmp_path):
    """Run every plan; fail with all that went wrong."""
    wrong = []
    for number, (seed, plan) in enumerate(plans):
        folder = tmp_path / str(number)
        folder.mkdir()
        wrong += [f"seed {seed}: {text}: {plan}" for text in judge(await trial(plan, folder, seed))]
        shutil.rmtree(folder)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault is not Fault.NONE])
async def test_a_fault_of_the_cable_costs_no_slab(fault, tmp_path):
    way, after = random.choice(list(Way)), random.randrange(NORMAL_TELEGRAMS)
    print(f"{way} {fault} {after}")
    outcome = await trial(Plan(link=[(way, fault, after)]), tmp_path)
    assert judge(outcome) == []
    assert outcome.job_state == "complete"
    assert len(outcome.table.grips) == SLABS


@pytest.mark.parametrize("how", ["cut", "forget"])
async def test_a_cable_that_is_cut_for_a_while_costs_no_slab(how, tmp_path):
    at = random.randrange(2 * NORMAL_TELEGRAMS)
    print(f"{how} {at}")
    outcome = await trial(Plan(cut_at=[(at, how, 0.3)]), tmp_path)
    assert judge(outcome) == []
    assert outcome.job_state == "complete"


async def test_seeds_of_every_kind_of_fault_cost_no_slab(tmp_path):
    first = int(os.environ.get("SLABCELL_FAULT_FIRST", secrets.randbelow(10**6)))
    print(f"SLABCELL_FAULT_FIRST={first}")
    await assert_survived([(seed, Plan.of(seed)) for seed in range(first, first + 6)], tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(7200)
async def test_a_thousand_seeds_cost_no_slab(tmp_path):
    first = int(os.environ.get("SLABCELL_FAULT_FIRST", "0"))
    count = int(os.environ.get("SLABCELL_FAULT_SEEDS", "1000"))
    await assert_survived([(seed, Plan.of(seed)) for seed in range(first, first + count)], tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(7200)
async def test_every_fault_at_every_telegram_costs_no_slab(tmp_path):
    faults = [fault for fault in Fault if fault is not Fault.NONE]
    plans = [
        (0, Plan(link=[(way, fault, after)])) for after in range(NORMAL_TELEGRAMS) for way in Way for fault in faults
    ]
    await assert_survived(plans, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(36000)
@pytest.mark.parametrize("kind", ["cancel", "power_hold", "power_drop"])
async def test_a_stop_at_every_statement_costs_no_slab(kind, tmp_path):
    await assert_survived([(0, Plan(stop_at=[(kind, at)])) for at in range(1, NORMAL_STATEMENTS)], tmp_path)
