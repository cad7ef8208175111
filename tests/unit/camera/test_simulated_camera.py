import asyncio
import time
from threading import Event

import numpy as np
import pytest

from slabcell_drivers.camera import (
    CameraBusy,
    CameraConfigError,
    CameraFault,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    CameraState,
    CameraTimeout,
    SimulatedCamera,
)

pytestmark = pytest.mark.unit

INFO = CameraInfo("slabcell", "test", "SIM-9", 64, 48, "Mono8")


def picture(number: int) -> np.ndarray:
    """Return a picture with an edge and its number in a corner."""
    pixels = np.zeros((INFO.height, INFO.width), np.uint8)
    pixels[:, 32:] = 200
    pixels[0, 0] = number
    return pixels


async def opened() -> SimulatedCamera:
    camera = SimulatedCamera(INFO, picture)
    await camera.open(1.0)
    return camera


async def test_a_camera_that_is_off_is_lost_by_name_and_comes_back_when_opened_again() -> None:
    camera = await opened()
    camera.break_with(CameraFault.OFF)

    with pytest.raises(CameraLost, match=r"SIM-9: no longer answers: check its power"):
        await camera.snap(1.0)
    assert camera.state is CameraState.LOST
    with pytest.raises(CameraLost, match=r"SIM-9: does not answer within 1 s"):
        await camera.open(1.0)

    camera.mend(CameraFault.OFF)
    with pytest.raises(CameraLost):
        await camera.snap(1.0)  # power alone is not enough: it must be configured anew
    await camera.open(1.0)
    assert (await camera.snap(1.0)).frame_id == 1


async def test_a_dropped_frame_is_a_timeout_by_its_deadline_and_leaves_a_gap_in_the_ids() -> None:
    camera = await opened()
    camera.break_with(CameraFault.DROP, frames=1)
    began_s = time.monotonic()

    with pytest.raises(CameraTimeout, match=r"SIM-9: no complete frame within 0\.05 s"):
        await camera.snap(0.05)

    assert time.monotonic() - began_s >= 0.05
    assert (await camera.snap(1.0)).frame_id == 2


async def test_a_late_frame_misses_a_short_deadline_and_meets_a_long_one() -> None:
    camera = await opened()
    camera.break_with(CameraFault.DELAYED, delay_s=0.1)

    with pytest.raises(CameraTimeout):
        await camera.snap(0.02)

    frame = await camera.snap(5.0)
    assert frame.received_s - frame.triggered_s >= 0.09


async def test_an_incomplete_frame_is_never_delivered() -> None:
    camera = await opened()
    camera.break_with(CameraFault.INCOMPLETE, frames=2)

    for _ in range(2):
        with pytest.raises(CameraIncomplete, match="packets were lost"):
            await camera.snap(1.0)

    assert (await camera.snap(1.0)).pixels[0, 0] == 3


async def test_a_dark_a_blurred_and_a_stuck_picture_look_like_it() -> None:
    camera = await opened()
    good = (await camera.snap(1.0)).pixels
    camera.break_with(CameraFault.STUCK, frames=1)
    stuck = (await camera.snap(1.0)).pixels
    camera.break_with(CameraFault.DARK, frames=1)
    dark = (await camera.snap(1.0)).pixels
    camera.break_with(CameraFault.BLUR, frames=1)
    blurred = (await camera.snap(1.0)).pixels

    assert np.array_equal(stuck, good)
    assert dark.max() < 10
    assert np.abs(np.diff(blurred[20].astype(int))).max() < 30
    assert (await camera.snap(1.0)).pixels[0, 0] == 5


async def test_mending_everything_makes_the_camera_whole() -> None:
    camera = await opened()
    for fault in (CameraFault.DARK, CameraFault.BLUR, CameraFault.INCOMPLETE):
        camera.break_with(fault)

    camera.mend()

    assert (await camera.snap(1.0)).pixels.max() == 200


async def test_a_picture_of_another_size_is_refused_with_both_sizes() -> None:
    camera = SimulatedCamera(INFO, lambda _: np.zeros((10, 20), np.uint8))
    await camera.open(1.0)

    with pytest.raises(CameraConfigError, match=r"20x10 pixels, the camera is set to 64x48"):
        await camera.snap(1.0)


async def test_a_picture_of_another_format_is_refused_with_both_formats() -> None:
    camera = SimulatedCamera(INFO, lambda _: np.zeros((48, 64), np.uint16))
    await camera.open(1.0)

    with pytest.raises(CameraConfigError, match=r"the picture is Mono16, the camera is set to Mono8"):
        await camera.snap(1.0)


async def test_a_twelve_bit_camera_delivers_sixteen_bits() -> None:
    info = CameraInfo("slabcell", "test", "SIM-9", 64, 48, "Mono12")
    camera = SimulatedCamera(info, lambda _: np.full((48, 64), 4000 << 4, np.uint16))
    await camera.open(1.0)

    frame = await camera.snap(1.0)

    assert frame.pixel_format == "Mono12"
    assert frame.pixels[0, 0] == 64_000


async def test_a_camera_that_another_program_controls_is_busy_until_that_one_lets_go() -> None:
    camera = SimulatedCamera(INFO, picture)
    camera.break_with(CameraFault.BUSY)

    with pytest.raises(CameraBusy, match="SIM-9: is controlled by another program"):
        await camera.open(1.0)
    assert camera.state is CameraState.LOST

    camera.mend()
    await camera.open(1.0)
    assert camera.state is CameraState.READY


async def test_a_camera_that_hangs_holds_neither_open_nor_snap_beyond_their_deadlines() -> None:
    camera = await opened()
    camera.break_with(CameraFault.HANG)

    with pytest.raises(CameraTimeout, match="no complete frame"):
        await camera.snap(0.03)
    with pytest.raises(CameraTimeout, match=r"no answer within 0\.03 s: switch it off and on"):
        await camera.open(0.03)
    assert camera.state is CameraState.LOST


async def test_opening_that_is_cancelled_does_not_leave_the_camera_half_open() -> None:
    camera = SimulatedCamera(INFO, picture)
    camera.break_with(CameraFault.HANG)
    task = asyncio.create_task(camera.open(60.0))
    await asyncio.sleep(0)
    assert camera.state is CameraState.OPENING

    task.cancel()

    with pytest.raises(asyncio.CancelledError):
        await task
    assert camera.state is CameraState.LOST


async def test_a_slow_rendering_does_not_hold_the_caller_beyond_its_deadline() -> None:
    gate = Event()

    def slow(_: int) -> np.ndarray:
        gate.wait(10.0)
        return picture(1)

    camera = SimulatedCamera(INFO, slow)
    await camera.open(1.0)
    try:
        with pytest.raises(CameraTimeout):
            await camera.snap(0.05)
    finally:
        gate.set()


async def test_the_picture_shows_the_world_after_the_trigger_not_before() -> None:
    world = {"level": 10}
    camera = SimulatedCamera(INFO, lambda _: np.full((48, 64), world["level"], np.uint8))
    await camera.open(1.0)
    await camera.snap(1.0)

    world["level"] = 20

    assert (await camera.snap(1.0)).pixels[0, 0] == 20


async def test_device_time_runs_forward() -> None:
    camera = await opened()

    one, other = await camera.snap(1.0), await camera.snap(1.0)

    assert one.device_timestamp_ns is not None
    assert other.device_timestamp_ns is not None
    assert other.device_timestamp_ns > one.device_timestamp_ns > 0
