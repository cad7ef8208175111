"""Does the Harvesters driver deliver whole, fresh frames, and survive producers that die?  With two real producers."""

import asyncio
import os
import signal
import subprocess
import sys
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slabcell_drivers.camera import CameraBusy, CameraConfigError, CameraLost, CameraState, CameraTimeout
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_library import AravisLibrary
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.gentl import ProducerBuildError, build
from slabcell_drivers.simulation.gige import GigeCamera, SensorLimits

from .conftest import PLAIN, need, serial_of
from .conftest import opened as opened_camera

pytestmark = pytest.mark.integration

MONO = "SN_InterfaceA_0"


@pytest.fixture(scope="session")
def tlsimu(harvesters: None) -> Path:
    path = Path(os.environ.get("SLABCELL_TLSIMU", f"{sys.prefix}/share/tlsimu/TLSimu.cti"))
    if not path.is_file():
        need(f"{path} is not there: it comes with the wheel that requirements/tlsimu.txt names")
    return path


def opened(camera: str, producer: Path, settings: CameraSettings) -> AbstractAsyncContextManager[HarvestersCamera]:
    return opened_camera(HarvestersCamera(camera, [producer], settings))


async def test_triggers_give_frames_in_order_from_an_independent_producer(tlsimu: Path) -> None:
    settings = CameraSettings(width=1920, height=1200, pixel_format="Mono8")
    async with opened(MONO, tlsimu, settings) as camera:
        assert camera.info is not None
        assert (camera.info.width, camera.info.height) == (1920, 1200)
        frames = [await camera.snap(5.0) for _ in range(20)]
        assert [frame.frame_id for frame in frames] == [frames[0].frame_id + step for step in range(20)]
        assert all(frame.pixels.shape == (1200, 1920) and frame.pixels.dtype == np.uint8 for frame in frames)
        assert all(frame.triggered_s < frame.received_s for frame in frames)
        assert len({id(frame.pixels) for frame in frames}) == 20


@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono10p"])
async def test_deep_pixels_come_at_full_scale(producer: Path, address: str, pixel_format: str) -> None:
    grey = np.full((480, 640), 0x8FC0, np.uint16)
    with GigeCamera(lambda _: grey, address, serial=serial_of(address), limits=SensorLimits(640, 480)):
        async with opened(serial_of(address), producer, replace(PLAIN, pixel_format=pixel_format)) as camera:
            frame = await camera.snap(5.0)
    assert np.array_equal(frame.pixels, grey)


async def test_a_producer_that_is_killed_costs_a_restart_of_its_process_only(tlsimu: Path) -> None:
    async with opened(MONO, tlsimu, CameraSettings(width=640, height=480)) as camera:
        await camera.snap(5.0)
        first = camera.process_id
        assert first is not None
        os.kill(first, signal.SIGKILL)
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost, match="process has ended"):
                await camera.snap(5.0)
        async with asyncio.timeout(60.0):
            await camera.until(CameraState.READY)
        assert camera.process_id not in (None, first)
        await camera.snap(5.0)
        assert camera.statistics.reconnects == 1


async def test_a_producer_that_hangs_is_a_timeout_in_time_and_can_be_closed(tlsimu: Path) -> None:
    async with opened(MONO, tlsimu, CameraSettings(width=640, height=480)) as camera:
        assert camera.process_id is not None
        os.kill(camera.process_id, signal.SIGSTOP)
        async with asyncio.timeout(10.0):
            with pytest.raises((CameraTimeout, CameraLost)):
                await camera.snap(1.0)


async def test_a_process_that_dies_while_nobody_looks_is_noticed(tlsimu: Path) -> None:
    async with opened(MONO, tlsimu, CameraSettings(width=640, height=480)) as camera:
        assert camera.process_id is not None
        os.kill(camera.process_id, signal.SIGKILL)
        async with asyncio.timeout(60.0):
            await camera.until(CameraState.LOST)
            await camera.until(CameraState.READY)


@pytest.mark.parametrize(
    ("camera", "settings", "error", "message"),
    [
        (MONO, CameraSettings(width=10_000), CameraConfigError, r"Width = 10000 is refused: it must be \d+ to 4096"),
        (MONO, CameraSettings(pixel_format="Mono9"), CameraConfigError, r"PixelFormat = Mono9 is refused: it takes "),
        (MONO, CameraSettings(exposure_us=5.0), CameraConfigError, r"has no feature ExposureTime"),
        ("SN_NOBODY", CameraSettings(), CameraLost, r"is not among the cameras of .*TLSimu.cti: SN_InterfaceA_0"),
    ],
)
async def test_what_is_refused_is_named(
    tlsimu: Path, camera: str, settings: CameraSettings, error: type[Exception], message: str
) -> None:
    found = HarvestersCamera(camera, [tlsimu], settings)
    with pytest.raises(error, match=message):
        await found.open(40.0)
    assert found.process_id is None


async def test_a_missing_producer_is_named() -> None:
    with pytest.raises(CameraConfigError, match=r"there is no GenTL producer /nowhere/x\.cti"):
        await HarvestersCamera("X", [Path("/nowhere/x.cti")]).open(5.0)


async def test_settings_are_applied_and_read_back_through_harvesters(producer: Path, gige: GigeCamera) -> None:
    wanted = CameraSettings(
        width=320, height=200, offset_x=64, offset_y=10, pixel_format="Mono12", exposure_us=2500.0, gain_db=6.0,
        packet_size=1500, packet_delay_ns=2000, heartbeat_ms=1500, features={"DeviceUserID": "north"},
    )  # fmt: skip
    async with opened(gige.device.serial, producer, wanted) as camera:
        frame = await camera.snap(5.0)
        assert (frame.pixels.shape, frame.pixels.dtype) == ((200, 320), np.uint16)
        assert (frame.said["offset_x"], frame.said["offset_y"]) == (64, 10)
        seen = gige.settings
        assert (seen.width, seen.height, seen.offset_x, seen.offset_y) == (320, 200, 64, 10)
        assert (seen.pixel_format.name, seen.exposure_us, seen.gain_db) == ("Mono12", 2500.0, 6.0)
        assert (seen.packet_size, seen.packet_delay_ns, seen.triggered) == (1500, 2000, True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            CameraSettings(exposure_us=5e7),
            r"ExposureTime = 50000000\.0 is refused: it must be 15 to 1000000; `slabcell",
        ),
        (CameraSettings(width=638), r"Width = 638 is refused: it must be 4 to 640 in steps of 4"),
        (CameraSettings(features={"TriggerMode": "Maybe"}), r"TriggerMode = Maybe is refused: it takes Off, On"),
    ],
)
async def test_a_setting_that_the_camera_refuses_is_named_through_harvesters(
    producer: Path, gige: GigeCamera, settings: CameraSettings, message: str
) -> None:
    with pytest.raises(CameraConfigError, match=message):
        await HarvestersCamera(gige.address, [producer], settings).open(40.0)


async def test_two_processes_cannot_both_control_a_camera(
    aravis: AravisLibrary, producer: Path, gige: GigeCamera
) -> None:
    async with opened(gige.device.serial, producer, PLAIN) as camera:
        second = HarvestersCamera(gige.device.serial, [producer], PLAIN)
        with pytest.raises((CameraBusy, CameraTimeout)):  # timeout: a busy machine had no time to ask twice
            await second.open(3.0)
        await camera.snap(5.0)
    async with asyncio.timeout(30.0):
        while await look(gige.address, 0.5) is not Sight.FREE:  # noqa: ASYNC110 - it is another process
            await asyncio.sleep(0.05)
    other = AravisCamera(gige.address, PLAIN)
    await other.open(5.0)
    await other.close()


UPDATE_TWICE = """
import sys
from harvesters.core import Harvester
found = Harvester()
found.add_file(sys.argv[1])
for _ in range(3):
    found.update()
    serials = [device.serial_number for device in found.device_info_list]
    assert sys.argv[2] in serials, serials
    acquirer = found.create({"serial_number": sys.argv[2]})
    nodes = acquirer.remote_device.node_map
    nodes.TriggerMode.value = "Off"
    for _ in range(2):
        acquirer.start()
        with acquirer.fetch(timeout=5.0) as buffer:
            assert buffer.payload.components[0].data.size == 640 * 480
        acquirer.stop()
    acquirer.destroy()
found.reset()
print("done")
"""


def test_our_own_producer_survives_update_and_new_acquirers(producer: Path, gige: GigeCamera) -> None:
    done = subprocess.run(
        [sys.executable, "-c", UPDATE_TWICE, str(producer), gige.device.serial],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.stdout.endswith("done\n"), done.stderr


def test_a_producer_that_cannot_be_built_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ProducerBuildError, match=r"no-such-compiler is not installed; apt-get install"):
        build(tmp_path)
    assert not list(tmp_path.rglob("*.cti"))
