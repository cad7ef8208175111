"""Is a camera, a light, a robot or a disk that is lost shown within two seconds?

By the deadlines that the watchers go by, which no load changes; and by the daemon's own stamp of the moment at which it
knew, with more time by as much as this machine was late meanwhile.
"""

import asyncio
import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest

from slabcell.service import camera_keeper, disk_watch
from slabcell_drivers.camera import supervision
from slabcell_drivers.light import SimulatedController, lit_camera, load_presets, serial_light
from slabcell_drivers.robot.answering import notice_dead_peer

pytestmark = [pytest.mark.faults, pytest.mark.timeout(300)]

PROMISED_S = 2.0
LIMIT_S = 60.0
NAP_S = 0.02
TRIES = 5
HANDS = 4
"""From the device to the stamp a loss goes through so many threads and processes, each of which may be late."""
CONFIG = Path(__file__).parents[2] / "config"


def test_the_deadlines_of_every_watcher_add_up_to_less_than_two_seconds():
    looks_s = 2 * (supervision.WATCH_EVERY_S + supervision.LOOK_S) + camera_keeper.LOOK_EVERY_S
    light_s = lit_camera.CHECK_EVERY_S + serial_light.CHECK_WITHIN_S
    disk_s = disk_watch.EVERY_S + disk_watch.ANSWERS_WITHIN_S
    assert max(looks_s, light_s, disk_s) <= PROMISED_S


def test_the_kernel_gives_a_silent_robot_two_seconds():
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as ours:
        notice_dead_peer(ours)
        tcp = socket.IPPROTO_TCP
        probes_s = ours.getsockopt(tcp, socket.TCP_KEEPINTVL) * ours.getsockopt(tcp, socket.TCP_KEEPCNT)
        assert ours.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        assert ours.getsockopt(tcp, socket.TCP_KEEPIDLE) + probes_s <= PROMISED_S
        assert 0 < ours.getsockopt(tcp, socket.TCP_USER_TIMEOUT) <= 1000 * PROMISED_S


class Lateness:
    """By how much naps are too long on this machine, summed up: what a loaded machine adds to every deadline."""

    def __init__(self) -> None:
        self.sum_s = 0.0


@contextlib.contextmanager
def measured_lateness() -> Iterator[Lateness]:
    found, over = Lateness(), threading.Event()

    def nap() -> None:
        while not over.is_set():
            began_s = time.monotonic()
            time.sleep(NAP_S)
            found.sum_s += time.monotonic() - began_s - NAP_S

    napping = threading.Thread(target=nap)
    napping.start()
    try:
        yield found
    finally:
        over.set()
        napping.join()


def link(cell, name):
    return next(it for it in json.loads(cell.slabcell("status", "--json").stdout)["links"] if it["name"] == name)


def until(cell, name, state):
    deadline = time.monotonic() + LIMIT_S
    while (found := link(cell, name))["state"] != state:
        assert time.monotonic() < deadline, found
    return found


def shown_after(cell, name, lose, mend) -> tuple[float, float]:
    """Return how long a loss took to be known, and by how much this machine was late meanwhile; both in seconds."""
    until(cell, name, "up")
    with measured_lateness() as late:
        lost_s = time.time()
        lose()
        down = until(cell, name, "down")
    mend()
    return datetime.fromisoformat(down["since"]).timestamp() - lost_s, late.sum_s


def judge(measure) -> None:
    """Of several tries one has to keep the promise: a deadline that is wrong is wrong each time."""
    found = []
    for _ in range(TRIES):
        took_s, late_s = measure()
        found.append((took_s, late_s))
        if took_s <= PROMISED_S + HANDS * late_s:
            break
    else:
        pytest.fail(f"shown after (s), while naps were late by (s): {found}")


def test_a_camera_that_is_lost_is_shown_within_two_seconds(cell):
    faults = cell.camera.faults
    with cell.daemon() as daemon:
        judge(
            lambda: shown_after(cell, "camera", lambda: faults.apply("freeze on"), lambda: faults.apply("freeze off"))
        )
        assert daemon.stop() == 0


@pytest.mark.parametrize("family", ["gardasoft-rt", "val-vlp"])
def test_a_light_that_is_lost_is_shown_within_two_seconds(cell, family):
    preset = load_presets(CONFIG / "lights.toml")[family]

    async def tried() -> None:
        async with SimulatedController(preset) as light:
            line = f'[light]\nurl = "{light.device}"\npreset = "{family}"\nbaud_rate = 115200\n'
            cell.edit("[robot]", f"{line}channels = [{{ channel = {max(preset.first_channel, 1)} }}]\n\n[robot]")

            def silence(*, on: bool) -> None:
                light.silent = on

            def whole() -> None:
                with cell.daemon() as daemon:
                    judge(lambda: shown_after(cell, "light", lambda: silence(on=True), lambda: silence(on=False)))
                    assert daemon.stop() == 0

            await asyncio.to_thread(whole)

    asyncio.run(tried())
