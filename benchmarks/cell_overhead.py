"""What does the cell add to camera and vision, and what does an acknowledgement cost beside a bare sync of this disk?

    python benchmarks/cell_overhead.py [--jobs 40] [--slots 5] [--think-ms 10] [--directory DIR]

Camera and vision are scripted and take no time, so that what is left of a trigger is the cell: telegrams of the EKI
link, states, planning with the arm's kinematics, ledger, events for who looks on, and the way between the threads.
From the moment that a telegram has come to the moment at which its answer is sent; the first offer is TRIGGER and NEXT
together.  A KR C4 needs about 10 ms to take a telegram apart and to fill and send the next one (measured by the authors
of `kuka_experimental`); that time is the robot's and does not count.  `--think-ms 0` is a robot that needs none.
Bundles of the job before are written meanwhile: from its end to the next trigger the robot drives for 0.1 s only.
"""

import argparse
import asyncio
import importlib.util
import logging
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import structlog

from slabcell.catalogue import Fault
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.service.api.ring import EventRing
from slabcell.service.event_feed import EventFeed
from slabcell.service.frames import FrameStore
from slabcell.service.history import History
from slabcell.service.links import Links
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.eki.link import Direction, EkiServer
from slabcell_drivers.robot.protocol import AckState, Answer, Request

DRIVE_S = 0.1
"""From the end of a job to the next trigger: time enough to write small bundles, and far less than a robot needs."""

KIT = Path(__file__).parents[1] / "tests" / "unit" / "cell" / "conftest.py"


def load_kit():
    """Return the scripted parts that the unit tests use."""
    spec = importlib.util.spec_from_file_location("cell_kit", KIT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["cell_kit"] = module
    spec.loader.exec_module(module)
    return module


def bare_fsync_ms(folder: Path, times: int) -> list[float]:
    """Return how long this disk needs to append 4 KiB and sync: the floor of every acknowledgement."""
    result = []
    with (folder / "floor").open("wb") as stream:
        for _ in range(times):
            began = time.perf_counter()
            stream.write(b"x" * 4096)
            stream.flush()
            os.fdatasync(stream.fileno())
            result.append((time.perf_counter() - began) * 1e3)
    return result


class Wire:
    """Both ends of an EKI link on loopback: asks the cell as a robot does, and notes how long each answer takes."""

    def __init__(self, cell: Cell, think_s: float) -> None:
        self._think_s = think_s
        self._server = EkiServer("127.0.0.1", 0, on_telegram=self._hear)
        self._cell = cell
        self._received_s = 0.0
        self.answered_in_ms = 0.0

    def _hear(self, direction: Direction, telegram: bytes, at_s: float) -> None:
        self._cell.overhear(direction.value, telegram, at_s)
        if direction is Direction.RECEIVED:
            self._received_s = at_s
        else:
            self.answered_in_ms = (at_s - self._received_s) * 1e3

    async def open(self) -> None:
        """Listen, and connect."""
        await self._server.start(self._cell.handle)
        self._reader, self._writer = await asyncio.open_connection(*self._server.address)

    async def handle(self, request: Request) -> Answer:
        """Send a request and return its answer."""
        self._writer.write(encode_request(request))
        return decode_answer(await self._reader.readuntil(b"</Vis>"))

    async def settled(self) -> None:
        """Take the robot's time, which it needs before it asks again."""
        await asyncio.sleep(self._think_s)

    async def close(self) -> None:
        """End both ends."""
        self._writer.close()
        await self._server.stop()


async def run(folder: Path, jobs: int, slots: int, think_s: float, *, bundles: bool) -> dict[str, list[float]]:
    """Return the times of every job, in milliseconds."""
    kit = load_kit()
    writer = BundleWriter(folder / "bundles") if bundles else None
    eyes = kit.ScriptedEyes(on_table=set(range(slots)))
    ledger = await Ledger.open(folder / "ledger.sqlite")
    cell = Cell(
        kit.ScriptedCamera(time.monotonic),
        kit.make_calibration(),
        kit.make_recipe(slots),
        arm=KR3_R540,
        settings=kit.make_settings(check_assembly_is_empty=False),
        ledger=ledger,
        bundles=writer,
        eyes=eyes,
    )
    history = await History.open(folder / "history.sqlite")
    feed = EventFeed(EventRing("benchmark"), history, Links(), FrameStore("benchmark"))
    cell.subscribe(feed.see)
    await cell.start()
    wire = Wire(cell, think_s)
    await wire.open()
    robot = kit.ScriptedRobot(wire)
    times: dict[str, list[float]] = {"first offer": [], "plan": [], "acknowledgement": [], "next": [], "fsync": []}
    for _ in range(jobs):
        await robot.hello()
        await asyncio.sleep(DRIVE_S)
        answer = await robot.trigger()
        trigger_ms = wire.answered_in_ms
        offer = (await robot.next()).offer
        times["first offer"].append(trigger_ms + wire.answered_in_ms)
        times["plan"].append(cell.cycles[-1].times_ms["plan"])
        left = answer.left
        while left:
            for state in (AckState.ACCEPTED, AckState.GRASPED, AckState.PLACED):
                left = (await robot.say(state, offer.result_id)).left
                times["acknowledgement"].append(wire.answered_in_ms)
            times["fsync"] += bare_fsync_ms(folder, 1)  # interleaved: both see the same disk
            offer = (await robot.next()).offer
            if offer is not None:
                times["next"].append(wire.answered_in_ms)
        eyes.lying = set(range(slots))
        assert (await robot.trigger()).code == 1
        cell.alarms.acknowledge(Fault.PLACEMENT_MISSING)
    await wire.close()
    await cell.stop()
    await ledger.close()
    await history.close()
    assert writer is None or writer.dropped == 0, "bundles were dropped"
    return times


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=40)
    parser.add_argument("--slots", type=int, default=5, choices=range(1, 6))
    parser.add_argument("--think-ms", type=float, default=10.0, help="what the robot needs from answer to request")
    parser.add_argument("--directory", type=Path, default=None, help="on the disk to be measured")
    options = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    for bundles in (False, True):
        with tempfile.TemporaryDirectory(dir=options.directory) as folder:
            think_s = options.think_ms / 1e3
            times = asyncio.run(run(Path(folder), options.jobs, options.slots, think_s, bundles=bundles))
        kept = "kept" if bundles else "not kept"
        print(
            f"{options.jobs} jobs of {options.slots} slabs, bundles {kept}, the robot thinks for {think_s * 1e3:g} ms"
        )
        for name, values in times.items():
            low, median, high = np.percentile(values, (5, 50, 95))
            print(f"  {name:16} median {median:6.2f} ms   5 % {low:6.2f}   95 % {high:6.2f}   ({len(values)} times)")


if __name__ == "__main__":
    main()
