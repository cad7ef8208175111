"""The cable between robot and cell is cut, or the connection forgotten, anywhere in a job: it ends as it should.

No slab is picked twice, none is lost without a record.  The cell, its ledger, its EKI server, the shipped programs and
the software KRC are the real ones; camera and eyes are scripted from the truth.
"""

import asyncio
import random
from dataclasses import dataclass
from pathlib import Path

import pytest

from slabcell_drivers.krc import SoftwareKrc, TraceEvent, read_project
from slabcell_drivers.krc.eki_faults import LinkFaults, Way
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki import EkiServer
from slabcell_drivers.robot.frame import Frame

from .squares import COMPLETE, PICK_BASE, PLACE_BASE, SLOTS, TOOL, Ending, World, judge, slots_and_states, squares_cell

pytestmark = pytest.mark.faults

KRL = Path(__file__).parents[2] / "krl"
OUT_VACUUM, IN_VACUUM = 1, 1
MAX_WALL_S = 30.0
MAX_STARTS = 12


class Wires:
    """Between the controller's I/O and the world."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.krc: SoftwareKrc | None = None

    def output_changed(self, index: int, value: bool, tcp: Frame) -> None:
        if index != OUT_VACUUM or self.krc is None:
            return
        if value:
            self.world.grip(tcp)
        else:
            self.world.release(tcp)
        self.krc.set_input(IN_VACUUM, self.world.vacuum)

    def moved(self, tcp: Frame) -> None:
        self.world.moved(tcp)


async def run_job(folder: Path, plan: "Plan") -> Ending:
    """Run one job over a cable on which everything of the plan happens; START is pressed after each stop."""
    world = World()
    async with squares_cell(folder, world) as (cell, ledger):
        link = EkiServer("127.0.0.1", 0, heartbeat_timeout_s=2.0, dead_after_s=2.0)
        await link.start(cell.handle)
        try:
            ending = await _run(world, link.address, plan)
        finally:
            await link.stop()
        ending.offers = await slots_and_states(ledger)
    return ending


async def _run(world: World, address: tuple[str, int], plan: "Plan") -> Ending:
    cable = LinkFaults(random.Random(1))
    log: list[str] = []
    wires = Wires(world)

    def trace(event: TraceEvent) -> None:
        log.append(f"{event.time_s:8.3f} {event.file}:{event.line} {event.kind} {event.text[:200]}")
        if event.kind == "telegram":
            plan.watch(cable)
        elif "the cable is cut" in event.text:
            cable.repair()  # once the robot has noticed

    krc = SoftwareKrc(
        read_project(KRL),
        robot=KR3_R540,
        eki_configs={path.stem: path.read_bytes() for path in KRL.glob("*.xml")},
        io=wires,
        trace=trace,
        trace_kinds=frozenset({"telegram", "io", "message"}),
        eki_link=cable,
        eki_addresses={"SlabCell": address},
    )
    wires.krc = krc
    try:
        for name, frame in (("TOOL_DATA[1]", TOOL), ("BASE_DATA[1]", PICK_BASE), ("BASE_DATA[2]", PLACE_BASE)):
            krc.set_data("", name, frame)
        krc.set_data("VT", "VT_TMOANSWER", 250)
        krc.set_data("VT", "VT_TMOTRIGGER", 500)
        result = await asyncio.to_thread(krc.run, "SlabCell", max_wall_s=MAX_WALL_S)
        starts = 1
        while result.status == "halted" and starts < MAX_STARTS:
            starts += 1
            result = await asyncio.to_thread(krc.go_on, max_wall_s=MAX_WALL_S)
        texts = [message.text for message in krc.messages]
    finally:
        await asyncio.to_thread(krc.close)
        cable.close()
    return Ending(world, [], texts, result.status, starts, log)


@dataclass
class Plan:
    """What happens to the cable once so many telegrams have been sent; a cut one is mended when the robot notices."""

    event: str
    at: int

    def watch(self, cable: LinkFaults) -> None:
        if self.event and cable.passed(Way.SENT) >= self.at:
            if self.event == "cut":
                cable.cut()
            else:
                cable.forget()
            self.event = ""


async def test_a_sound_cable_lays_every_slab_once(tmp_path: Path) -> None:
    ending = await run_job(tmp_path, Plan("", 0))
    judge(ending, "no fault")
    assert sorted(ending.world.picks) == list(range(SLOTS))
    assert ending.texts == [COMPLETE]
    assert ending.starts == 1


MOMENTS = [3, 8, *(pytest.param(at, marks=pytest.mark.slow) for at in range(1, 20) if at not in {3, 8})]


@pytest.mark.parametrize("at", MOMENTS)
@pytest.mark.parametrize("event", ["cut", "forgotten"])
async def test_a_job_survives_a_cable_that_is_cut_or_a_connection_that_is_forgotten(
    tmp_path: Path, event: str, at: int
) -> None:
    ending = await run_job(tmp_path, Plan(event, at))
    judge(ending, f"{event} at telegram {at}")
    assert ending.texts[-1] == COMPLETE
