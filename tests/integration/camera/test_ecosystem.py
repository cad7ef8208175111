"""Do our drivers stream from independent cameras, and independent programs from ours?"""

import os
import signal
import subprocess
from collections.abc import Callable, Iterator

import pytest

from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.discovery import Interface, discover
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.simulation.gige import GigeCamera

from .conftest import need

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("aravis")]

LOOPBACK = [Interface("lo", "127.0.0.1", "127.255.255.255")]
QUICK = {**os.environ, "LC_ALL": "C"}


def run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=True, env=QUICK).stdout


def test_arv_tool_reads_and_writes_our_features(gige: GigeCamera, tool: Callable[[str], str]) -> None:
    out = run(tool("arv-tool-0.8"), "-a", gige.address, "control", "Width", "ExposureTime=2000", "DeviceSerialNumber")
    assert "Width = 640" in out
    assert f"DeviceSerialNumber = {gige.device.serial}" in out
    assert gige.settings.exposure_us == 2000


def test_arv_camera_test_streams_from_our_camera(gige: GigeCamera, tool: Callable[[str], str]) -> None:
    out = run(
        tool("arv-camera-test-0.8"), "-n", gige.address, "-f", "40", "--no-packet-socket", "-a", "--duration", "1",
        "-w", "320", "-h", "200", "-i", "8000",
    )  # fmt: skip
    counts = dict(line.split("=") for line in out.splitlines() if line.startswith("n_"))
    counts = {name.strip(): int(value) for name, value in counts.items()}
    assert counts["n_completed_buffers"] >= 5  # of 40, if nothing else runs on the machine
    assert counts["n_completed_buffers"] > counts["n_failures"]


@pytest.fixture
def fake_camera(tool: Callable[[str], str]) -> Iterator[str]:
    """The camera program of Aravis; it lives on 127.0.0.1 and cannot be had twice."""
    process = subprocess.Popen([tool("arv-fake-gv-camera-0.8"), "-i", "127.0.0.1", "-s", f"FAKE-{os.getpid()}"])
    try:
        for _ in range(50):
            if any(d.serial == f"FAKE-{os.getpid()}" for d in discover(0.2, on=LOOPBACK, ask=("127.0.0.1",))):
                break
        else:
            need("UDP port 3956 of 127.0.0.1 is taken: the fake camera of Aravis cannot be tested here now")
        yield "127.0.0.1"
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10)


async def test_our_driver_streams_from_the_fake_camera_of_aravis(fake_camera: str) -> None:
    # Its ids begin at 65400, it looks for triggers 25 times a second, knows no test packet and no resend.
    settings = CameraSettings(width=128, height=128, packet_size=1400, exposure_us=1000.0, heartbeat_ms=2000)
    camera = AravisCamera(fake_camera, settings)
    try:
        info = await camera.open(20.0)
        assert (info.vendor, info.width) == ("Aravis", 128)
        frames = [await camera.snap(5.0) for _ in range(10)]
        assert [frame.frame_id for frame in frames] == [frames[0].frame_id + step for step in range(10)]
        assert all(frame.pixels.shape == (128, 128) for frame in frames)
        assert camera.statistics.retries == 0
    finally:
        await camera.close()
