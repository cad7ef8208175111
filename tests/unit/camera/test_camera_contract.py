"""What every camera must do, whichever driver it is."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell_drivers.camera import (
    Camera,
    CameraInfo,
    CameraLost,
    CameraState,
    ReplayCamera,
    ReplayMode,
    SimulatedCamera,
)

pytestmark = pytest.mark.unit

INFO = CameraInfo("slabcell", "test", "T-1", 64, 48, "Mono8")


def picture(number: int) -> np.ndarray:
    """Return a picture that tells its number."""
    return np.full((INFO.height, INFO.width), number % 256, np.uint8)


def simulated(_: Path) -> Camera:
    return SimulatedCamera(INFO, picture)


def replayed(folder: Path) -> Camera:
    for number in range(1, 6):
        cv2.imwrite(str(folder / f"{number:03d}.png"), picture(number))
    return ReplayCamera(folder, mode=ReplayMode.LOOP, serial="T-1")


@pytest.fixture
def serial() -> str:
    return INFO.serial


@pytest.fixture(params=[simulated, replayed], ids=["simulated", "replay"])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[], Camera]:
    return lambda: request.param(tmp_path)


async def test_a_camera_is_closed_until_it_is_opened_and_again_after_it_is_closed(
    serial: str, make: Callable[[], Camera]
) -> None:
    camera = make()
    assert camera.state is CameraState.CLOSED

    info = await camera.open(5.0)
    assert camera.state is CameraState.READY
    assert (info.serial, info.width, info.height, info.pixel_format) == (serial, 64, 48, "Mono8")

    await camera.close()
    await camera.close()
    assert camera.state is CameraState.CLOSED


async def test_each_trigger_gives_one_frame_with_ids_that_count_up_and_times_in_order(
    make: Callable[[], Camera],
) -> None:
    camera = make()
    await camera.open(5.0)

    frames = []
    for _ in range(4):
        called_s = time.monotonic()
        frame = await camera.snap(5.0)
        assert called_s <= frame.triggered_s <= frame.received_s <= time.monotonic()
        frames.append(frame)

    first = frames[0].frame_id  # a real camera takes a priming frame at every start
    assert [frame.frame_id for frame in frames] == list(range(first, first + 4))
    assert [int(frame.pixels[0, 0]) for frame in frames] == list(range(first, first + 4))
    await camera.close()


async def test_a_frame_owns_its_pixels(make: Callable[[], Camera]) -> None:
    camera = make()
    await camera.open(5.0)

    first = await camera.snap(5.0)
    kept = first.pixels.copy()
    first_again = first.pixels
    second = await camera.snap(5.0)
    second.pixels[:] = 99

    assert np.array_equal(first_again, kept)
    assert not np.shares_memory(first.pixels, second.pixels)
    assert first.pixels.base is None or first.pixels.flags.owndata
    await camera.close()


async def test_a_closed_camera_takes_no_picture(make: Callable[[], Camera]) -> None:
    camera = make()

    with pytest.raises(CameraLost, match="open it"):
        await camera.snap(1.0)


async def test_a_camera_opened_again_counts_anew(make: Callable[[], Camera]) -> None:
    camera = make()
    await camera.open(5.0)
    await camera.snap(5.0)
    await camera.close()

    await camera.open(5.0)

    first, second = (await camera.snap(5.0)).frame_id, (await camera.snap(5.0)).frame_id
    assert 1 <= first <= 4
    assert second == first + 1
    await camera.close()


async def test_two_triggers_at_once_are_taken_one_after_the_other(make: Callable[[], Camera]) -> None:
    camera = make()
    await camera.open(5.0)

    frames = await asyncio.gather(*(camera.snap(5.0) for _ in range(3)))

    ids = sorted(frame.frame_id for frame in frames)
    assert ids == list(range(ids[0], ids[0] + 3))
    assert all(int(frame.pixels[0, 0]) == frame.frame_id for frame in frames)
    await camera.close()


async def test_a_cancelled_trigger_leaves_the_camera_usable(make: Callable[[], Camera]) -> None:
    camera = make()
    await camera.open(5.0)
    task = asyncio.create_task(camera.snap(5.0))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task

    frame = await camera.snap(5.0)

    assert frame.pixels.shape == (48, 64)
    await camera.close()
