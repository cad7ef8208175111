"""Is every frame of a long run whole, in order and its trigger's own, and does nothing grow?  Long with -m slow."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from slabcell_drivers.camera import CameraIncomplete, CameraTimeout
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera

from .conftest import MakeCamera, Program, serial_of

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("aravis")]

LONG = pytest.param(10_000, marks=[pytest.mark.slow, pytest.mark.timeout(4 * 3600)])
MAX_KB_A_FRAME = 0.2


@dataclass
class Usage:
    """What one process uses in the course of a run: after which frame, kB resident, threads, descriptors."""

    process: int
    samples: list[tuple[int, int, int, int]] = field(default_factory=list)

    def note(self, frame: int) -> None:
        own = Path(f"/proc/{self.process}")
        resident = next(line for line in (own / "status").read_text().splitlines() if line.startswith("VmRSS"))
        counts = (len(list((own / name).iterdir())) for name in ("task", "fd"))
        self.samples.append((frame, int(resident.split()[1]), *counts))

    def growth(self) -> tuple[float, int, int]:
        """Return kB a frame, and by how much threads and descriptors vary."""
        table = np.array(self.samples, float)
        slope = np.polyfit(table[:, 0], table[:, 1], 1)[0] if len(table) > 10 else 0.0
        return float(slope), int(np.ptp(table[:, 2])), int(np.ptp(table[:, 3]))


@pytest.mark.parametrize("count", [30, LONG])
async def test_every_trigger_gives_its_own_whole_frame_and_nothing_grows(
    address: str, program: Callable[..., Program], make: MakeCamera, count: int
) -> None:
    pattern = CheckedPattern()
    running = program("--address", address, "--serial", serial_of(address))
    camera = make(address, CameraSettings(packet_size=8000))
    await camera.open(30.0)
    try:
        usages = {"this process": Usage(os.getpid()), "camera": Usage(running.process_id)}
        if isinstance(camera, HarvestersCamera) and camera.process_id is not None:
            usages["producer's process"] = Usage(camera.process_id)
        last, retries = 0, camera.statistics.retries
        for index in range(count):
            called_s = time.monotonic()
            frame = await camera.snap(10.0)
            number = pattern.number_of(frame.pixels)
            assert number is not None
            if index and camera.statistics.retries == retries:
                assert number == last + 1
            assert number > last
            last, retries = number, camera.statistics.retries
            # The camera in software stamps with this machine's monotonic clock, when its exposure begins.
            assert frame.device_timestamp_ns is not None
            assert frame.device_timestamp_ns / 1e9 >= called_s
            # Buffers and caches have been filled by then; few samples, for they take memory themselves.
            if index >= count // 5 and index % max(1, count // 100) == 0:
                for usage in usages.values():
                    usage.note(index)
        print(camera.statistics)
        for name, usage in usages.items():
            kb_a_frame, threads, descriptors = usage.growth()
            print(f"{name}: {kb_a_frame:+.4f} kB a frame, threads +-{threads}, descriptors +-{descriptors}")
            assert threads <= 2, name  # the executor of asyncio may begin a thread
            assert descriptors <= 2, name
            if count >= 10_000:
                assert kb_a_frame < MAX_KB_A_FRAME, name
    finally:
        await camera.close()


@pytest.mark.parametrize("count", [30, LONG])
@pytest.mark.parametrize("resend", [True, False], ids=["resent", "not resent"])
async def test_at_half_a_percent_of_loss_no_bad_frame_is_ever_delivered(
    address: str, make: MakeCamera, count: int, resend: bool
) -> None:
    seed = int.from_bytes(os.urandom(4), "big")
    print(f"seed {seed}")
    pattern = CheckedPattern()
    delivered = refused = 0
    with GigeCamera(pattern, address, serial=serial_of(address), seed=seed) as gige:
        # Nothing can still come 30 ms after a frame that is not sent again.
        settings = CameraSettings(packet_size=8000, resend=resend, frame_retention_us=100_000 if resend else 30_000)
        camera = make(address, settings)
        await camera.open(30.0)
        gige.faults.apply("loss 0.005")
        gige.faults.apply(f"noresend {'off' if resend else 'on'}")
        try:
            # Not resent, three frames in four are lost; go on until one has come.
            while gige.counts.frames < count or not delivered:
                try:
                    frame = await camera.snap(3.0)
                except (CameraIncomplete, CameraTimeout):
                    refused += 1
                    continue
                delivered += 1
                assert pattern.number_of(frame.pixels) == gige.counts.triggers
            print(f"{gige.counts}; delivered {delivered}, refused {refused}; {camera.statistics}")
            assert gige.counts.packets_lost > 0
            assert resend or camera.statistics.incomplete > 0
        finally:
            gige.faults.apply("mend")
            await camera.close()
