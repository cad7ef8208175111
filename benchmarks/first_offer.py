"""What does the cell add to a real picture and the real vision, from TRIGGER to the first offer on the wire?

    python benchmarks/first_offer.py [--jobs 60] [--scene irregular] [--think-ms 10] [--directory DIR]

The scene is rendered once, and delivered 30 ms after each request as a camera would; vision, planning, ledger, events,
log and EKI link are those of the daemon.  A time runs from a telegram's arrival to the sending of its answer, TRIGGER
and NEXT together; what the cell itself says that camera and vision took is taken off.  Every trigger begins a job with
all slabs of the scene.  See `cell_overhead` for the robot's own time (``--think-ms``).
"""

import argparse
import asyncio
import gc
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.cell_overhead import Wire, load_kit
from tests.integration.test_cell_simulated import CONFIG, settings_of, true_calibration

from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.logs import log_to_file
from slabcell.recipe import load_recipe
from slabcell.service.api.ring import EventRing
from slabcell.service.event_feed import EventFeed
from slabcell.service.frames import FrameStore
from slabcell.service.history import History
from slabcell.service.links import Links
from slabcell_drivers.camera.protocol import ImageFrame
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.simulation import World, load_scene, render_world

CAMERA_S = 0.03
DRIVE_S = 0.5
"""From the end of a job to the next trigger, as in the quickest cell; its bundle is written meanwhile."""


class StillCamera:
    """Delivers the same picture again and again."""

    def __init__(self, pixels: np.ndarray) -> None:
        self._pixels = pixels
        self._frames = 0

    async def snap(self, timeout_s: float) -> ImageFrame:
        """Return the picture after the time that a camera takes."""
        del timeout_s
        self._frames += 1
        triggered_s = time.monotonic()
        await asyncio.sleep(CAMERA_S)
        return ImageFrame(self._pixels, "Mono8", self._frames, triggered_s, time.monotonic())


async def run(folder: Path, scene: str, jobs: int, think_s: float) -> dict[str, list[float]]:
    """Return the times of every job, in milliseconds."""
    world = World(load_scene(CONFIG / "scenes" / f"{scene}.toml"), 7)
    ledger = await Ledger.open(folder / "ledger.sqlite")
    history = await History.open(folder / "history.sqlite")
    cell = Cell(
        StillCamera(render_world(world, 1)),
        true_calibration(world),
        load_recipe(CONFIG / "recipes" / f"{scene}.toml"),
        arm=KR3_R540,
        settings=settings_of(world, check_assembly_is_empty=False),
        ledger=ledger,
        bundles=BundleWriter(folder / "bundles"),
    )
    cell.subscribe(EventFeed(EventRing("benchmark"), history, Links(), FrameStore("benchmark")).see)
    await cell.start()
    wire = Wire(cell, think_s)
    await wire.open()
    robot = load_kit().ScriptedRobot(wire)
    gc.collect()
    gc.freeze()  # as the daemon does
    times: dict[str, list[float]] = {"first offer adds": [], "TRIGGER": [], "NEXT": [], "plan": [], "vision": []}
    for _ in range(jobs):
        await robot.hello()
        await asyncio.sleep(DRIVE_S)
        answer = await robot.trigger()
        cycle, triggered_ms = cell.cycles[-1], wire.answered_in_ms
        assert answer.left, "the picture showed no slab"
        assert (await robot.next()).offer is not None
        vision_ms = cycle.result.timing_ms["total"]
        times["TRIGGER"].append(triggered_ms - cycle.times_ms["acquire"] - vision_ms)
        times["NEXT"].append(wire.answered_in_ms)
        times["first offer adds"].append(times["TRIGGER"][-1] + times["NEXT"][-1])
        times["plan"].append(cycle.times_ms["plan"])
        times["vision"].append(vision_ms)
        await robot.hello()  # takes the results back
        await cell.abandon_job()
    await wire.close()
    await cell.stop()
    await ledger.close()
    await history.close()
    return times


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=60)
    parser.add_argument("--scene", default="irregular")
    parser.add_argument("--think-ms", type=float, default=10.0, help="what the robot needs from answer to request")
    parser.add_argument("--directory", type=Path, default=None, help="on the disk to be measured")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.directory) as folder:
        log_to_file(Path(folder) / "log")
        times = asyncio.run(run(Path(folder), options.scene, options.jobs, options.think_ms / 1e3))
    for name, values in times.items():
        low, median, high = np.percentile(values, (5, 50, 95))
        print(f"{name:16} median {median:6.2f} ms   5 % {low:6.2f}   95 % {high:6.2f}   ({len(values)} times)")


if __name__ == "__main__":
    main()
