"""Does the Aravis driver deliver a whole, fresh frame for every trigger, or name in time why not?"""

import asyncio
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import numpy as np
import pytest

from slabcell_drivers.camera import (
    CameraBusy,
    CameraConfigError,
    CameraIncomplete,
    CameraLost,
    CameraState,
    CameraTimeout,
)
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.discovery import Interface
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera, SensorLimits

pytestmark = [pytest.mark.integration, pytest.mark.usefixtures("aravis")]

FAST = CameraSettings(packet_size=8000, exposure_us=1000.0, gain_db=13.9794, heartbeat_ms=2000)  # gain: 5 ms again
PLAIN = CameraSettings(packet_size=8000, heartbeat_ms=2000)
LOOPBACK = [Interface("lo", "127.0.0.1", "127.255.255.255")]


@asynccontextmanager
async def opened(
    address: str, settings: CameraSettings = PLAIN, timeout_s: float = 20.0
) -> AsyncIterator[AravisCamera]:
    camera = AravisCamera(address, settings, on=LOOPBACK)
    try:
        await camera.open(timeout_s)
        yield camera
    finally:
        await camera.close()


async def until_ready(camera: AravisCamera) -> None:
    async with asyncio.timeout(60):
        await camera.until(CameraState.READY)


async def until_lost(camera: AravisCamera) -> None:
    async with asyncio.timeout(60):
        await camera.until(CameraState.LOST)


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


async def test_a_camera_is_found_by_its_serial_number_and_a_wrong_one_is_named(gige: GigeCamera) -> None:
    async with opened(gige.device.serial) as camera:
        await camera.snap(5.0)
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
        seen = gige.settings
        assert (seen.width, seen.height, seen.offset_x, seen.offset_y) == (320, 200, 64, 10)
        assert (seen.pixel_format.name, seen.exposure_us, seen.gain_db) == ("Mono12", 2500.0, 6.0)
        assert (seen.packet_size, seen.packet_delay_ns, seen.triggered) == (1500, 2000, True)


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


async def test_a_camera_that_sends_nothing_is_a_timeout_before_the_deadline_and_works_again(
    gige: GigeCamera, pattern: CheckedPattern
) -> None:
    async with opened(gige.address, FAST) as camera:
        gige.faults.apply("hang on")
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraTimeout):
                await camera.snap(1.5)
        gige.faults.apply("hang off")
        assert pattern.number_of((await camera.snap(5.0)).pixels) == gige.counts.triggers


async def test_a_frame_that_comes_too_late_is_never_taken_for_the_next_one(address: str) -> None:
    pattern = CheckedPattern(640, 480)
    with GigeCamera(pattern, address, limits=SensorLimits(640, 480)) as gige:
        async with opened(address) as camera:
            for _ in range(2):
                gige.faults.apply("late 1.2")
                with pytest.raises((CameraTimeout, CameraIncomplete)):
                    await camera.snap(1.0)
                gige.faults.apply("late 0")
                before = gige.counts.triggers
                frame = await camera.snap(5.0)
                number = pattern.number_of(frame.pixels)
                assert number is not None
                assert number > before


@pytest.mark.parametrize("fault", ["drop 1", "truncate 1", "size 1", "reset-ids 500"])
async def test_one_bad_frame_is_taken_again_within_the_deadline(
    gige: GigeCamera, pattern: CheckedPattern, fault: str
) -> None:
    async with opened(gige.address) as camera:
        await camera.snap(5.0)
        gige.faults.apply(fault)
        frame = await camera.snap(3.0)
        assert pattern.number_of(frame.pixels) is not None
        assert camera.statistics.retries == 1
        await camera.snap(5.0)
        assert camera.statistics.retries == 1


async def test_frames_that_stay_bad_are_named_and_never_delivered(gige: GigeCamera) -> None:
    async with opened(gige.address) as camera:
        for k in range(1, 40):
            gige.faults.apply(f"truncate {k}")
        with pytest.raises(CameraIncomplete, match="stream-test"):
            await camera.snap(5.0)
        gige.faults.apply("mend")
        await camera.snap(5.0)


async def test_block_ids_may_wrap_from_65535_to_1(gige: GigeCamera, pattern: CheckedPattern) -> None:
    gige.faults.apply("reset-ids 65530")
    async with opened(gige.address) as camera:
        ids = [(await camera.snap(5.0)).frame_id for _ in range(8)]
        first = ids[0]
        assert first > 65_530
        assert ids == [(first - 1 + step) % 65_535 + 1 for step in range(8)]
        assert 0 not in ids
        assert camera.statistics.retries == 0


async def test_lost_packets_are_sent_again(address: str) -> None:
    pattern = CheckedPattern()
    with GigeCamera(pattern, address) as gige:
        async with opened(address, CameraSettings(packet_size=8000)) as camera:
            gige.faults.apply("loss 0.01")
            for _ in range(10):
                assert pattern.number_of((await camera.snap(5.0)).pixels) == gige.counts.triggers
            assert camera.statistics.packets_resent > 0


async def test_without_resends_no_bad_frame_is_delivered(address: str) -> None:
    pattern = CheckedPattern()
    with GigeCamera(pattern, address) as gige:
        async with opened(address, CameraSettings(packet_size=8000, resend=False)) as camera:
            gige.faults.apply("loss 0.003")
            whole = 0
            for _ in range(12):
                try:
                    frame = await camera.snap(5.0)
                except (CameraIncomplete, CameraTimeout):
                    continue
                assert pattern.number_of(frame.pixels) == gige.counts.triggers
                whole += 1
            assert camera.statistics.incomplete > 0
            assert whole > 0


async def test_a_killed_camera_is_lost_within_the_deadline_and_comes_back_by_itself(
    address: str, program: Callable[..., object]
) -> None:
    options = ("--address", address, "--width", "640", "--height", "480")
    running = program(*options)
    pattern = CheckedPattern(640, 480)
    async with opened(address) as camera:
        assert pattern.number_of((await camera.snap(5.0)).pixels) is not None
        running.signal(signal.SIGKILL)
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost):
                await camera.snap(1.5)
        assert camera.state is CameraState.LOST
        with pytest.raises(CameraLost, match=address):
            await camera.snap(1.0)
        program(*options)
        await until_ready(camera)
        assert pattern.number_of((await camera.snap(5.0)).pixels) is not None
        assert camera.statistics.reconnects == 1


async def test_an_idle_camera_that_goes_is_noticed_without_a_trigger(
    address: str, program: Callable[..., object]
) -> None:
    running = program("--address", address, "--width", "640", "--height", "480")
    async with opened(address) as camera:
        running.signal(signal.SIGKILL)
        await until_lost(camera)
        program(
            "--address", address, "--width", "640", "--height", "480"
        )  # the library is quicker to let go of what answers


async def test_a_camera_that_was_switched_off_and_on_is_taken_back(address: str) -> None:
    pattern = CheckedPattern(640, 480)
    with GigeCamera(pattern, address, limits=SensorLimits(640, 480)):
        camera = AravisCamera(address, PLAIN)
        await camera.open(5.0)
        await camera.snap(5.0)
    with GigeCamera(pattern, address, limits=SensorLimits(640, 480)) as again:
        await until_lost(camera)
        await until_ready(camera)
        assert pattern.number_of((await camera.snap(5.0)).pixels) == again.counts.triggers
        await camera.close()


async def test_a_stopped_camera_is_lost_within_the_deadline_and_comes_back_when_it_goes_on(
    address: str, program: Callable[..., object]
) -> None:
    running = program("--address", address, "--width", "640", "--height", "480")
    async with opened(address) as camera:
        running.signal(signal.SIGSTOP)
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost):
                await camera.snap(1.5)
        running.signal(signal.SIGCONT)
        await until_ready(camera)
        await camera.snap(5.0)


async def test_a_camera_whose_control_is_dead_is_lost(gige: GigeCamera) -> None:
    async with opened(gige.address) as camera:
        gige.faults.apply("freeze on")
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost):
                await camera.snap(1.5)
        gige.faults.apply("freeze off")
        await until_ready(camera)
        await camera.snap(5.0)


async def test_a_second_client_is_told_that_the_camera_is_busy_and_the_first_goes_on(gige: GigeCamera) -> None:
    async with opened(gige.address) as camera:
        second = AravisCamera(gige.address, PLAIN)
        with pytest.raises(CameraBusy, match="another client"):
            await second.open(1.0)
        await camera.snap(5.0)
    async with opened(gige.address) as second:
        await second.snap(2.0)


async def test_after_a_client_was_killed_the_next_one_gets_the_camera_when_the_heartbeat_has_passed(
    gige: GigeCamera,
) -> None:
    code = (
        "import asyncio, sys\n"
        "from slabcell_drivers.camera.aravis import AravisCamera\n"
        "from slabcell_drivers.camera.settings import CameraSettings\n"
        "async def main():\n"
        "    camera = AravisCamera(sys.argv[1], CameraSettings(heartbeat_ms=2000, packet_size=8000))\n"
        "    await camera.open(5.0)\n"
        "    await camera.snap(5.0)\n"
        "    print('open', flush=True)\n"
        "    await asyncio.sleep(60)\n"
        "asyncio.run(main())\n"
    )
    client = await asyncio.create_subprocess_exec(sys.executable, "-c", code, gige.address, stdout=subprocess.PIPE)
    assert client.stdout is not None
    assert await client.stdout.readline() == b"open\n"
    client.kill()
    await client.wait()
    assert await look(gige.address, 1.0) is Sight.CONTROLLED
    async with opened(gige.address) as camera:
        await camera.snap(5.0)


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
