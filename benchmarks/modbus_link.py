"""What does a PLC wait for its poll while a cycle runs, and what does its polling cost the cycle?

    python benchmarks/modbus_link.py [--cycles 12] [--hz 100]

A process of its own polls the whole answer area over TCP loopback; the cell's process takes pictures of a simulated
table and evaluates them, with and without the poller by turns, so that both see the same machine.
"""

import argparse
import asyncio
import logging
import multiprocessing
import statistics
import tempfile
import time
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import structlog

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane
from slabcell.cell.cell import Cell
from slabcell.cell.ledger import Ledger
from slabcell.cell.settings import CellSettings
from slabcell.geometry import Polygon
from slabcell.recipe import load_recipe
from slabcell.service.modbus_config import shipped_map
from slabcell.service.simulated import SimulatedCell
from slabcell_drivers.robot import Frame, Request, RequestType
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.modbus import Access, ModbusTcpServer, RegisterClient, tcp_client
from slabcell_drivers.robot.modbus.register_map import Area
from slabcell_drivers.simulation import load_scene

TOOL = Frame(z_mm=260.0)


def poll(address: tuple[str, int], hz: float, going, ending, results) -> None:
    """Poll while ``going`` is set, until ``ending`` is; give the times from poll to answer, in milliseconds."""

    async def talk() -> list[float]:
        client = RegisterClient(tcp_client(*address, 5.0), shipped_map(), timeout_s=5.0)
        await client.connect()
        start, count = shipped_map().span(Area.ANSWER)
        times: list[float] = []
        due = time.perf_counter()
        while not ending.is_set():
            if going.is_set():
                began = time.perf_counter()
                await client.read(start, count)
                times.append((time.perf_counter() - began) * 1e3)
            due = max(due + 1.0 / hz, time.perf_counter())
            await asyncio.sleep(due - time.perf_counter())
        client.close()
        return times

    results.put(asyncio.run(talk()))


async def measure(folder: Path, cycles: int, hz: float) -> tuple[list[float], list[float], list[float]]:
    """Return cycle times without and with the poller, and the poller's times, in milliseconds."""
    with as_file(files("slabcell") / "data" / "config") as config:
        scene = load_scene(config / "scenes" / "dresden.toml")
        recipe = load_recipe(config / "recipes" / "dresden.toml")
    world = SimulatedCell(scene, 3, KR3_R540, TOOL)
    spec = scene.camera
    view = (scene.table.frame.inverse() @ spec.frame).matrix
    rotation = view[:3, :3].T
    calibration = Calibration(
        CameraIdentity(spec.width, spec.height, spec.serial),
        Lens(
            np.array([[spec.fx_px, 0.0, spec.cx_px], [0.0, spec.fy_px, spec.cy_px], [0.0, 0.0, 1.0]]),
            np.array(spec.distortion),
        ),
        TablePlane(rotation, -rotation @ view[:3, 3]),
    )
    area = Polygon.from_points(scene.table.pick_area)
    settings = CellSettings(scene.table.frame, scene.assembly.frame, TOOL, area, camera_timeout_s=20.0)
    await world.camera.open(10.0)
    ledger = await Ledger.open(folder / "ledger.sqlite")
    cell = Cell(world.camera, calibration, recipe, arm=KR3_R540, settings=settings, ledger=ledger)
    await cell.start()
    link = ModbusTcpServer("127.0.0.1", 0, shipped_map(), access=Access(["127.0.0.1"]))
    await link.start(cell.handle)
    context = multiprocessing.get_context("spawn")
    going, ending, results = context.Event(), context.Event(), context.Queue()
    poller = context.Process(target=poll, args=(link.address, hz, going, ending, results))
    poller.start()
    await asyncio.to_thread(_wait_for, link)
    session = (await cell.handle(Request(RequestType.HELLO, 0, 1))).session
    without: list[float] = []
    along: list[float] = []
    for number in range(2 * cycles + 2):
        polled = number % 2 == 1
        (going.set if polled else going.clear)()
        await asyncio.sleep(0.05)
        began = time.perf_counter()
        answer = await cell.handle(Request(RequestType.TRIGGER, session, number + 2))
        assert answer.code == 0, answer
        if number >= 2:  # the first two warm up
            (along if polled else without).append((time.perf_counter() - began) * 1e3)
    ending.set()
    times = await asyncio.to_thread(results.get)
    await asyncio.to_thread(poller.join)
    await link.stop()
    await cell.stop()
    await ledger.close()
    await world.camera.close()
    return without, along, times


def _wait_for(link: ModbusTcpServer) -> None:
    while not link.counters.connections:
        time.sleep(0.01)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=12)
    parser.add_argument("--hz", type=float, default=100.0)
    options = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    with tempfile.TemporaryDirectory() as folder:
        without, along, times = asyncio.run(measure(Path(folder), options.cycles, options.hz))
    median, p99 = np.percentile(times, (50, 99))
    print(f"poll to answer, {len(times)} polls at {options.hz:g} Hz: median {median:.2f} ms, p99 {p99:.2f} ms")
    ratio = statistics.median(b / a for a, b in zip(without, along, strict=True))
    print(
        f"cycle without poller: median {statistics.median(without):.1f} ms; with: {statistics.median(along):.1f} ms;"
        f" paired ratio, median {ratio:.3f}"
    )


if __name__ == "__main__":
    main()
