"""A camera is killed (kill -9) in mid-stream: how soon is it named, how soon is it back, and what had to wait?

    python benchmarks/camera_killed.py [--kills N] [--driver aravis|harvesters|both] [--json]

The camera is `slabcell sim camera` in a process of its own on loopback, 1920x1200 Mono8.  It is killed at a random
moment of a picture and started again.  All the while three things are noted every 5 ms: how late the driver's event
loop comes; how late without the time that its thread stood in the kernel's queue for a processor, which is the
machine's doing; and how late a bare loop comes that does nothing, in a process beside it.
"""

import argparse
import asyncio
import contextlib
import json
import os
import random
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slabcell_drivers.camera import CameraError, CameraLost, CameraState
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.gentl import build

SETTINGS = CameraSettings(packet_size=8000, heartbeat_ms=3000)
ADDRESS, SERIAL = "127.0.0.93", "KILLED-1"
DEADLINE_S = 1.5
TICK_S = 0.005
BARE = "--bare-loop"


@dataclass
class Feeler:
    """How late a loop comes, and how much of it its thread waited for a processor; both in seconds."""

    late_s: list[float] = field(default_factory=list[float])
    own_s: list[float] = field(default_factory=list[float])

    async def feel(self) -> None:
        """Note it until cancelled."""
        statistics = os.open("/proc/thread-self/schedstat", os.O_RDONLY)
        try:
            queued_s = _queued_s(statistics)
            while True:
                began_s = time.perf_counter()
                await asyncio.sleep(TICK_S)
                late_s = time.perf_counter() - began_s - TICK_S
                before_s, queued_s = queued_s, _queued_s(statistics)
                self.late_s.append(late_s)
                self.own_s.append(max(0.0, late_s - (queued_s - before_s)))
        finally:
            os.close(statistics)

    def figures(self) -> dict[str, float]:
        """Return the greatest and the 99.9th percentile, and how often 20 ms were exceeded."""
        late, own = np.array(self.late_s) * 1e3, np.array(self.own_s) * 1e3
        return {
            "ticks": len(late),
            "late_max_ms": float(late.max()),
            "late_p999_ms": float(np.percentile(late, 99.9)),
            "late_over_20_ms": int((late > 20).sum()),
            "not_queued_max_ms": float(own.max()),
            "not_queued_over_20_ms": int((own > 20).sum()),
        }


def _queued_s(descriptor: int) -> float:
    """Return how long the thread has waited for a processor so far (Linux, Documentation/scheduler/sched-stats)."""
    return int(os.pread(descriptor, 100, 0).split()[1]) / 1e9


def start_camera() -> subprocess.Popen[str]:
    """Run a camera as a program, and return when it is ready."""
    command = [str(Path(sys.executable).parent / "slabcell"), "sim", "camera", "--address", ADDRESS, "--serial", SERIAL]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert "ready" in process.stdout.readline()
    return process


def end_camera(process: subprocess.Popen[str]) -> None:
    """Kill the program, as a cable is pulled."""
    process.kill()
    process.communicate()


async def one_kill(camera: SupervisedCamera, program: subprocess.Popen[str]) -> tuple[dict[str, float], Any]:
    """Kill the camera in a picture and bring it back; return what that took and the new program."""
    for _ in range(random.randrange(3, 12)):
        await camera.snap(5.0)
    began_s = time.monotonic()
    shot = asyncio.create_task(camera.snap(DEADLINE_S))
    await asyncio.sleep(random.uniform(0.0, 0.01))
    await asyncio.to_thread(end_camera, program)
    with contextlib.suppress(CameraLost):
        await shot  # killed between two pictures: the next one finds it gone
        began_s = time.monotonic()
        await camera.snap(DEADLINE_S)
    named_s = time.monotonic() - began_s
    assert camera.state is CameraState.LOST
    await asyncio.sleep(random.uniform(0.5, 3.0))
    program = await asyncio.to_thread(start_camera)
    back_s = time.monotonic()
    while True:
        await camera.until(CameraState.READY)
        with contextlib.suppress(CameraError):
            await camera.snap(2.0)
            break
    return {"after_deadline_s": named_s - DEADLINE_S, "frames_after_return_s": time.monotonic() - back_s}, program


async def measure(driver: str, kills: int) -> dict[str, Any]:
    """Kill one driver's camera again and again."""
    program = await asyncio.to_thread(start_camera)
    camera = AravisCamera(ADDRESS, SETTINGS) if driver == "aravis" else HarvestersCamera(SERIAL, [build()], SETTINGS)
    found: list[dict[str, float]] = []
    try:
        await camera.open(20.0)
        feeler = Feeler()
        feeling = asyncio.create_task(feeler.feel())
        bare = await asyncio.create_subprocess_exec(
            sys.executable, __file__, BARE, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        for _ in range(kills):
            figures, program = await one_kill(camera, program)
            found.append(figures)
        feeling.cancel()
        beside, _ = await bare.communicate(b"")
    finally:
        await camera.close()
        end_camera(program)
    summary = {name: {"median": float(np.median(v)), "max": max(v)} for name, v in _columns(found).items()}
    return {"kills": kills, **summary, "loop": feeler.figures(), "bare_loop": json.loads(beside)}


def _columns(rows: list[dict[str, float]]) -> dict[str, list[float]]:
    return {name: [row[name] for row in rows] for name in rows[0]}


async def bare_loop() -> None:
    """Be the loop that does nothing, until the input ends."""
    feeler = Feeler()
    feeling = asyncio.create_task(feeler.feel())
    await asyncio.to_thread(sys.stdin.read)
    feeling.cancel()
    print(json.dumps(feeler.figures()))


def main() -> None:
    """Measure the drivers that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--driver", choices=("aravis", "harvesters", "both"), default="both")
    parser.add_argument("--json", action="store_true")
    parser.add_argument(BARE, action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.bare_loop:
        asyncio.run(bare_loop())
        return
    for driver in ("aravis", "harvesters") if options.driver == "both" else (options.driver,):
        result = asyncio.run(measure(driver, options.kills))
        print(json.dumps({"driver": driver, **result}) if options.json else f"{driver}: {json.dumps(result, indent=2)}")


if __name__ == "__main__":
    main()
