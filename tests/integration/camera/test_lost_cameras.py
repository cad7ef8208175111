"""Is a camera that goes named in time, and does it come back by itself, the same and set as before?  Both drivers."""

import asyncio
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest

from slabcell_drivers.camera import CameraBusy, CameraLost, CameraState
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.simulation.gige import CheckedPattern, GigeCamera, SensorLimits

from .conftest import PLAIN, MakeCamera, Program, opened, serial_of, until

pytestmark = pytest.mark.integration

LIMITS = SensorLimits(640, 480)


@pytest.fixture
def small_program(address: str, program: Callable[..., Program]) -> Callable[[], Program]:
    """Starts the camera of this test as a program."""
    return lambda: program("--address", address, "--serial", serial_of(address), "--width", "640", "--height", "480")


async def test_a_killed_camera_is_lost_within_the_deadline_and_comes_back_by_itself(
    address: str, pattern: CheckedPattern, small_program: Callable[[], Program], make: MakeCamera
) -> None:
    running = small_program()
    async with opened(make(address, PLAIN)) as camera:
        assert pattern.number_of((await camera.snap(5.0)).pixels) is not None
        running.signal(signal.SIGKILL)
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost):
                await camera.snap(1.5)
        assert camera.state is CameraState.LOST
        with pytest.raises(CameraLost, match="is lost"):
            await camera.snap(1.0)
        small_program()
        await until(camera, CameraState.READY)
        assert pattern.number_of((await camera.snap(5.0)).pixels) is not None
        assert camera.statistics.reconnects == 1


async def test_a_stopped_camera_is_lost_within_the_deadline_and_comes_back_when_it_goes_on(
    address: str, small_program: Callable[[], Program], make: MakeCamera
) -> None:
    running = small_program()
    async with opened(make(address, PLAIN)) as camera:
        running.signal(signal.SIGSTOP)
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost):
                await camera.snap(1.5)
        running.signal(signal.SIGCONT)
        await until(camera, CameraState.READY)
        await camera.snap(5.0)


async def test_a_camera_whose_control_is_dead_is_lost(gige: GigeCamera, make: MakeCamera) -> None:
    async with opened(make(gige.address, PLAIN)) as camera:
        gige.faults.apply("freeze on")
        async with asyncio.timeout(10.0):
            with pytest.raises(CameraLost):
                await camera.snap(1.5)
        gige.faults.apply("freeze off")
        await until(camera, CameraState.READY)
        await camera.snap(5.0)


async def test_a_camera_that_was_switched_off_and_on_is_set_again_as_it_was(
    address: str, pattern: CheckedPattern, make: MakeCamera
) -> None:
    wanted = replace(
        PLAIN, width=320, height=200, exposure_us=2500.0, gain_db=6.0206, features={"DeviceUserID": "left"}
    )
    camera = make(address, wanted)
    with GigeCamera(pattern, address, serial=serial_of(address), limits=LIMITS) as gige:
        await camera.open(40.0)
        set_so = replace(gige.settings, destination=("", 0))
        await camera.snap(5.0)
    with GigeCamera(pattern, address, serial=serial_of(address), limits=LIMITS) as gige:
        assert gige.settings.width == 640
        await until(camera, CameraState.LOST)
        await until(camera, CameraState.READY)
        assert replace(gige.settings, destination=("", 0)) == set_so
        assert gige.counts.triggers > 0  # the priming frame, of which nobody hears
        assert (await camera.snap(5.0)).pixels.shape == (200, 320)
        await camera.close()


async def test_another_camera_at_the_same_address_is_not_taken_for_the_one_that_was_opened(
    address: str, pattern: CheckedPattern, make: MakeCamera
) -> None:
    with GigeCamera(pattern, address, serial=serial_of(address), limits=LIMITS):
        camera = make(address, PLAIN)
        await camera.open(40.0)
    with GigeCamera(pattern, address, serial="ANOTHER", limits=LIMITS) as other:
        await until(camera, CameraState.LOST)
        async with asyncio.timeout(30.0):
            while "ANOTHER" not in camera.cause and other.controller is None:  # noqa: ASYNC110 - its own time
                await asyncio.sleep(0.02)
        assert camera.state is CameraState.LOST
        with pytest.raises(CameraLost):
            await camera.snap(1.0)
    with GigeCamera(pattern, address, serial=serial_of(address), limits=LIMITS):
        await until(camera, CameraState.READY)
        await camera.snap(5.0)
        await camera.close()


async def test_a_second_client_is_told_that_the_camera_is_busy_and_the_first_goes_on(
    gige: GigeCamera, make: MakeCamera
) -> None:
    async with opened(make(gige.address, PLAIN)) as camera:
        second = make(gige.address, PLAIN)
        with pytest.raises(CameraBusy, match="another client"):
            await second.open(4.0)
        await camera.snap(5.0)
    async with opened(make(gige.address, PLAIN)) as second:
        await second.snap(5.0)


HOLD_THE_CAMERA = """
import asyncio, sys
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.settings import CameraSettings
async def main():
    camera = AravisCamera(sys.argv[1], CameraSettings(heartbeat_ms=2000, packet_size=8000))
    await camera.open(5.0)
    await camera.snap(5.0)
    print("open", flush=True)
    await asyncio.sleep(60)
asyncio.run(main())
"""


async def test_after_our_process_was_killed_a_new_one_controls_the_camera_within_heartbeat_and_a_second(
    gige: GigeCamera,
    aravis: object,
) -> None:
    client = await asyncio.create_subprocess_exec(
        sys.executable, "-c", HOLD_THE_CAMERA, gige.address, stdout=subprocess.PIPE
    )
    assert client.stdout is not None
    assert await client.stdout.readline() == b"open\n"
    client.kill()
    await client.wait()
    assert await look(gige.address, 1.0) is Sight.CONTROLLED
    # The driver gives up at the time that it is given: heartbeat timeout and one second.
    async with opened(AravisCamera(gige.address, PLAIN), timeout_s=PLAIN.heartbeat_ms / 1000 + 1.0) as camera:
        await camera.snap(5.0)
