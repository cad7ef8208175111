"""Does the cell stay as small as it was?  Many cycles with faults drawn at random; memory, files and threads watched.

    python benchmarks/cell_soak.py [--cycles 20000] [--seed N] [--directory DIR]

The real cell with ledger and bundles; camera, eyes and robot are scripted, and so is the world: slabs on a table and in
slots.  Drawn at random: camera faults, failed picks, slabs lost from the gripper, links lost at any telegram, restarts
of the cell.  At the end no slab is lost without a record and none lies twice in a slot, or the command fails.
"""

import argparse
import asyncio
import gc
import logging
import os
import random
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import structlog

from cell_overhead import load_kit
from slabcell.catalogue import Fault
from slabcell.cell.retention import Retention
from slabcell_drivers.camera.protocol import CameraIncomplete, CameraLost, CameraTimeout
from slabcell_drivers.robot.protocol import AckState

SLABS = 3
SAMPLES = 40
WARM_UP = 4
"""One in so many samples, the first ones, is left out: caches fill."""
MAX_GROWTH = {"resident memory": 0.02, "open files": 0.0, "threads": 0.0}
"""By the line of least squares through the samples, relative to the first; half a file or thread is none."""


def sizes() -> tuple[int, int, int]:
    """Return resident memory in KiB, open files, threads."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return (
        pages * os.sysconf("SC_PAGE_SIZE") // 1024,
        len(list(Path("/proc/self/fd").iterdir())),
        threading.active_count(),
    )


class Soak:
    """One cell, and a robot with bad luck."""

    def __init__(self, kit, folder: Path, seed: int) -> None:
        self.bench = kit.Bench(folder)
        self.bench.bundles = True
        self.bench.retention = Retention(max_bytes=1 << 20, failures_max_bytes=1 << 20, min_free_bytes=0)
        self.bench.settings = kit.make_settings(attempts_per_slot=1_000_000)
        self.dice = random.Random(seed)
        self.cycles = self.jobs = self.faults = 0
        self.where = dict.fromkeys(range(SLABS), "table")

    @property
    def robot(self):
        """The robot; after a restart of the cell it is another one with the same memory."""
        return self.bench.robot

    def look(self) -> None:
        """Let the eyes see the world."""
        eyes = self.bench.eyes
        eyes.on_table = {slab for slab, place in self.where.items() if place == "table"}
        eyes.lying = {slab for slab, place in self.where.items() if place == "slot"}

    def chance(self, share: float) -> bool:
        """Return whether a fault of this share happens now."""
        happens = self.dice.random() < share
        self.faults += happens
        return happens

    async def job(self) -> None:
        """Fill the template once, whatever happens."""
        bench = self.bench
        self.robot.job_id = 1 + self.jobs % 30_000
        self.where = dict.fromkeys(range(SLABS), "table")
        self.look()
        greet = True
        while True:
            if greet:
                resumed = (await self.robot.hello()).offer
                greet = False
                if resumed is not None:
                    await self.put_down(resumed.slot)
                elif self.robot.holds:
                    self.take_out()
                await self.person()
            self.look()
            if self.chance(0.05):
                bench.camera.script.append(self.dice.choice([CameraTimeout, CameraLost, CameraIncomplete])("drawn"))
            answer = await self.robot.trigger()
            self.cycles += 1
            if answer.code == 1:
                break
            if answer.code > 1000:
                await self.person()
                continue
            greet = await self.lay(answer.left)
        assert set(self.where.values()) == {"slot"}, self.where
        rows = await bench.ledger.run(lambda book: book.offers(bench.cell.job.job_id))
        placed = sorted(row.slot for row in rows if row.state == "placed")
        assert placed == list(range(SLABS)), placed
        for noted in (bench.events, bench.eyes.asked, bench.eyes.measured):
            noted.clear()  # what the scripted parts note for tests would grow with every cycle
        self.jobs += 1

    async def rest(self) -> None:
        """Wait until the bundles that are on their way are written: how many files that takes is not of interest."""
        while self.bench.cell._cycles._keeping or self.bench.cell._cycles._bundles._waiting:  # noqa: ASYNC110 - now and then
            await asyncio.sleep(0.01)

    async def lay(self, left: int) -> bool:
        """Lay what is offered; return whether the link was lost on the way."""
        while left:
            offer = (await self.robot.next()).offer
            if offer is None or self.chance(0.02):
                return True
            await self.robot.say(AckState.ACCEPTED, offer.result_id)
            if self.chance(0.03):
                return await self.accident()
            if self.chance(0.03):
                await self.robot.say(AckState.PICK_FAILED)
                return False
            self.where[offer.slot] = "hand"
            left = (await self.robot.say(AckState.GRASPED)).left
            if self.chance(0.02):  # it falls back onto the table
                self.take_out()
                await self.robot.say(AckState.ABORTED)
                await self.person()
                return False
            if self.chance(0.03):
                return await self.accident()
            left = (await self.put_down(offer.slot)).left
        return False

    async def put_down(self, slot: int):
        """Lay the slab in hand into its slot, and say so."""
        assert self.where[slot] != "slot", "two slabs in one slot"
        self.where[slot] = "slot"
        self.look()
        return await self.bench.robot.say(AckState.PLACED)

    def take_out(self) -> None:
        """Let the slab in hand lie on the table."""
        self.where = {slab: "table" if place == "hand" else place for slab, place in self.where.items()}
        self.bench.robot.holds = False
        self.look()

    async def accident(self) -> bool:
        """Lose the link, and sometimes the whole cell with it."""
        if self.chance(0.2):
            await self.bench.restart()
        return True

    async def person(self) -> None:
        """Look at what is unknown, and clear what can be cleared."""
        cell = self.bench.cell
        for offer in await cell._desk.unknown():
            await cell.resolve(offer.result_id, placed=self.where[offer.slot] == "slot")
        for fault in (Fault.PART_LOST, Fault.TRIED_TOO_OFTEN):
            if cell.alarms.has(fault):
                await cell.acknowledge(fault)


async def run(cycles: int, seed: int, folder: Path) -> None:
    """Run, print a line for each sample, and judge them."""
    soak = Soak(load_kit(), folder, seed)
    await soak.bench.start()
    began, rows = time.perf_counter(), []
    print(f"seed {seed}\n{'cycles':>8} {'jobs':>7} {'faults':>7} {'RSS KiB':>9} {'files':>6} {'threads':>8} {'1/s':>6}")
    for sample in range(1, SAMPLES + 1):
        while soak.cycles < cycles * sample // SAMPLES:
            await soak.job()
        await soak.rest()
        rows.append(sizes())
        rate = soak.cycles / (time.perf_counter() - began)
        kib, files, threads = rows[-1]
        print(f"{soak.cycles:8} {soak.jobs:7} {soak.faults:7} {kib:9} {files:6} {threads:8} {rate:6.1f}", flush=True)
    await soak.bench.stop()
    print("no slab lost or doubled")
    judge(rows[len(rows) // WARM_UP :], cycles * (WARM_UP - 1) / WARM_UP)


def judge(rows: list[tuple[int, int, int]], cycles: float) -> None:
    """Print by how much each size grew over these samples, and fail if one did."""
    grown: list[str] = []
    for (name, limit), sizes_ in zip(MAX_GROWTH.items(), zip(*rows, strict=True), strict=True):
        slope, start = np.polyfit(np.arange(len(sizes_)), sizes_, 1)
        growth, allowed = float(slope) * (len(sizes_) - 1), max(limit * float(start), 0.5)
        print(f"{name}: {start:.1f} {growth:+.1f} in {cycles:.0f} cycles, {allowed:.1f} allowed")
        if growth > allowed:
            grown.append(name)
    assert not grown, f"not flat: {', '.join(grown)}"


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(1 << 32))
    parser.add_argument("--directory", type=Path, default=None)
    options = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    with tempfile.TemporaryDirectory(dir=options.directory) as folder:
        asyncio.run(run(options.cycles, options.seed, Path(folder)))


if __name__ == "__main__":
    sys.exit(main())
