"""Does the Aravis driver deliver a whole, fresh frame for every trigger, or name in time why not?"""

import asyncio
import signal
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import replace

import numpy as np
import pytest

from slabcell_drivers.camera import CameraConfigError, CameraLost, CameraState
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_device import kernel_buffer_limit
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera, SensorLimits

from .conftest import LOOPBACK, PLAIN, Program, until
from .conftest import opened as opened_camera

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("aravis")]

FAST = CameraSettings(packet_size=8000, exposure_us=1000.0, gain_db=13.9794, heartbeat_ms=2000)  # gain: 5 ms again


def opened(camera: str, settings: CameraSettings = PLAIN) -> AbstractAsyncContextManager[AravisCamera]:
    return opened_camera(AravisCamera(camera, settings, on=LOOPBACK))


async def test_fifty_triggers_give_fifty_whole_frames_each_its_own(address: str) -> None:
    pattern = CheckedPattern()
    with GigeCamera(pattern, address, serial="FIFTY") as gige:
        async with opened(address, CameraSettings(heartbeat_ms=2000)) as camera:
            assert camera.info is not None
            assert (camera.info.serial, camera.info.width, camera.info.height) == ("FIFTY", 1920, 1200)
            for _ in range(50):
                called_s = time.monotonic()
                frame = await camera.snap(5.0)
                assert called_s <= frame.triggered_s <= frame.received_s <= time.monotonic()
                assert pattern.number_of(frame.pixels) == gige.counts.triggers
                assert frame.device_timestamp_ns is not None
                assert frame.device_timestamp_ns / 1e9 >= called_s
            assert camera.statistics.frames == 50


async def test_a_camera_is_found_by_address_serial_mac_and_user_name_and_a_wrong_one_is_named(gige: GigeCamera) -> None:
    async with opened(gige.address, replace(PLAIN, features={"DeviceUserID": "north"})):
        pass
    for name in (gige.device.serial, gige.device.mac_text, "north"):
        async with opened(name) as camera:
            assert camera.info is not None
            assert camera.info.serial == gige.device.serial
    absent = AravisCamera("NO-SUCH-SERIAL", PLAIN, on=LOOPBACK)
    with pytest.raises(CameraLost, match="NO-SUCH-SERIAL"):
        await absent.open(0.4)


async def test_settings_are_applied_and_read_back(gige: GigeCamera) -> None:
    wanted = CameraSettings(
        width=320, height=200, offset_x=64, offset_y=10, pixel_format="Mono12", exposure_us=2500.0, gain_db=6.0,
        packet_size=1500, packet_delay_ns=2000, heartbeat_ms=1500, features={"DeviceUserID": "north"},
    )  # fmt: skip
    async with opened(gige.address, wanted) as camera:
        frame = await camera.snap(5.0)
        assert frame.pixels.shape == (200, 320)
        assert frame.pixels.dtype == np.uint16
        assert (frame.said["offset_x"], frame.said["offset_y"], frame.said["status"]) == (64, 10, "success")
        seen = gige.settings
        assert (seen.width, seen.height, seen.offset_x, seen.offset_y) == (320, 200, 64, 10)
        assert (seen.pixel_format.name, seen.exposure_us, seen.gain_db) == ("Mono12", 2500.0, 6.0)
        assert (seen.packet_size, seen.packet_delay_ns, seen.triggered) == (1500, 2000, True)
        read = await camera.read("GevHeartbeatTimeout", "TriggerSource", "TriggerMode", "GevSCPD", "DeviceUserID")
        assert list(read.values()) == [1500, "Software", "On", 2000, "north"]
        assert camera.statistics.socket_buffer_bytes == min(kernel_buffer_limit(), wanted.socket_buffer_bytes)


async def test_without_a_packet_size_the_largest_that_passes_is_found(gige: GigeCamera) -> None:
    async with opened(gige.address, CameraSettings(packet_size=576)):
        assert gige.settings.packet_size == 576
    async with opened(gige.address, CameraSettings()):
        assert gige.settings.packet_size > 8000


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (CameraSettings(exposure_us=5e7), r"ExposureTime = 50000000\.0 is refused: it must be 15 to 1000000"),
        (CameraSettings(width=641), r"Width = 641 is refused: it must be 4 to 640"),
        (CameraSettings(pixel_format="Mono9"), r"PixelFormat = Mono9 is refused: it takes .*Mono8"),
        (CameraSettings(features={"Colour": 1}), r"has no feature Colour"),
        (CameraSettings(features={"TriggerMode": "Maybe"}), r"TriggerMode = Maybe is refused: it takes .*On"),
    ],
)
async def test_a_setting_that_is_refused_is_named_with_value_and_range(
    gige: GigeCamera, settings: CameraSettings, message: str
) -> None:
    camera = AravisCamera(gige.address, settings)
    with pytest.raises(CameraConfigError, match=message):
        await camera.open(5.0)
    await camera.close()


async def test_exposure_changes_the_brightness(address: str) -> None:
    grey = np.full((480, 640), 100, np.uint8)
    with GigeCamera(lambda _: grey, address, limits=SensorLimits(640, 480)):
        for exposure_us, brightness in ((5000.0, 100), (2500.0, 50), (10_000.0, 200)):
            async with opened(address, CameraSettings(exposure_us=exposure_us, packet_size=8000)) as camera:
                frame = await camera.snap(5.0)
                assert abs(float(frame.pixels.mean()) - brightness) <= 1


@pytest.mark.parametrize(
    "pixel_format", ["Mono8", "Mono10p", "Mono12Packed", "Mono16", "BayerRG8", "BayerGB12", "RGB8"]
)
async def test_every_kind_of_pixel_format_arrives_as_it_was_seen(address: str, pixel_format: str) -> None:
    scene = np.zeros((480, 640, 3), np.uint8)
    scene[:] = (40, 120, 200)
    with GigeCamera(lambda _: scene, address, limits=SensorLimits(640, 480)):
        async with opened(address, CameraSettings(pixel_format=pixel_format, packet_size=8000)) as camera:
            frame = await camera.snap(5.0)
    assert frame.pixel_format == pixel_format
    scale = 257 if frame.pixels.dtype == np.uint16 else 1
    middle = frame.pixels[100:200, 100:200].astype(int) / scale
    wanted = (40, 120, 200) if frame.pixels.ndim == 3 else 0.114 * 40 + 0.587 * 120 + 0.299 * 200
    assert np.abs(middle - wanted).max() <= 1.1


async def test_an_idle_camera_that_goes_is_noticed_without_a_trigger(
    address: str, program: Callable[..., Program]
) -> None:
    running = program("--address", address, "--width", "640", "--height", "480")
    async with opened(address) as camera:
        running.signal(signal.SIGKILL)
        await until(camera, CameraState.LOST)
        program(
            "--address", address, "--width", "640", "--height", "480"
        )  # the library is quicker to let go of what answers


async def test_two_cameras_at_once_do_not_mix(address: str, another_address: str) -> None:
    patterns = {address: CheckedPattern(640, 480), another_address: CheckedPattern(320, 200)}
    with (
        GigeCamera(patterns[address], address, limits=SensorLimits(640, 480)),
        GigeCamera(patterns[another_address], another_address, limits=SensorLimits(320, 200)),
    ):
        async with opened(address) as first, opened(another_address) as second:
            for _ in range(10):
                frames = await asyncio.gather(first.snap(2.0), second.snap(2.0))
                assert patterns[address].number_of(frames[0].pixels) is not None
                assert patterns[another_address].number_of(frames[1].pixels) is not None


async def test_a_cancelled_trigger_leaves_the_camera_usable(gige: GigeCamera, pattern: CheckedPattern) -> None:
    async with opened(gige.address) as camera:
        task = asyncio.create_task(camera.snap(5.0))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert pattern.number_of((await camera.snap(5.0)).pixels) == gige.counts.triggers


async def test_opening_and_closing_again_and_again_always_leaves_the_camera_free(gige: GigeCamera) -> None:
    for _ in range(10):
        async with opened(gige.address, FAST) as camera:
            await camera.snap(5.0)
        assert await look(gige.address, 1.0) is Sight.FREE
