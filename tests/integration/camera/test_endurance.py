"""Is every frame of a long run whole, in order and its trigger's own, and does nothing grow?  Long with -m slow."""

import os
from pathlib import Path

import numpy as np
import pytest

from slabcell_drivers.camera import CameraIncomplete, CameraTimeout
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("aravis")]

SETTINGS = CameraSettings(packet_size=8000)
LONG = pytest.param(10_000, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])


def figures() -> tuple[int, int, int]:
    """Return kB resident, threads and descriptors of this process."""
    own = Path("/proc/self")
    return resident_kb(), len(list((own / "task").iterdir())), len(list((own / "fd").iterdir()))


def resident_kb() -> int:
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith("VmRSS")).split()[1])


@pytest.mark.parametrize("count", [10, LONG])
async def test_every_trigger_gives_its_own_whole_frame_and_nothing_grows(address: str, count: int) -> None:
    pattern = CheckedPattern()
    samples: list[tuple[int, int, int, int]] = []
    with GigeCamera(pattern, address) as gige:
        camera = AravisCamera(address, SETTINGS)
        await camera.open(20.0)
        try:
            for index in range(count):
                frame = await camera.snap(10.0)
                assert pattern.number_of(frame.pixels) == gige.counts.triggers
                # Buffers and caches have been filled by then; few samples, for they take memory themselves.
                if index >= count // 5 and index % max(1, count // 200) == 0:
                    samples.append((index, *figures()))
        finally:
            await camera.close()
    table = np.array(samples, float)
    assert np.ptp(table[:, 2]) <= 2  # the executor of asyncio may begin a thread
    assert np.ptp(table[:, 3]) <= 2
    if count >= 10_000:
        kb_a_frame = np.polyfit(table[:, 0], table[:, 1], 1)[0]
        assert abs(kb_a_frame) < 0.2, f"memory grows by {kb_a_frame:.3f} kB a frame"


@pytest.mark.parametrize("count", [10, LONG])
@pytest.mark.parametrize("resend", [True, False])
async def test_at_half_a_percent_of_loss_no_bad_frame_is_ever_delivered(address: str, count: int, resend: bool) -> None:
    seed = int.from_bytes(os.urandom(4), "big")
    print(f"seed {seed}")
    pattern = CheckedPattern()
    delivered = 0
    with GigeCamera(pattern, address, seed=seed) as gige:
        camera = AravisCamera(address, CameraSettings(packet_size=8000, resend=resend))
        await camera.open(20.0)
        gige.faults.apply("loss 0.005")
        try:
            # Without resends three frames in four are lost; go on until one has come.
            for number in range(count + 200):
                if number >= count and delivered:
                    break
                try:
                    frame = await camera.snap(3.0)
                except (CameraIncomplete, CameraTimeout):
                    continue
                delivered += 1
                assert pattern.number_of(frame.pixels) == gige.counts.triggers
            assert camera.statistics.packets_resent + camera.statistics.incomplete > 0
            assert delivered > 0
        finally:
            gige.faults.apply("mend")
            await camera.close()
