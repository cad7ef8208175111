"""Is a lost camera asked again at the right times, whatever its backend does?"""

import asyncio
from collections.abc import Callable

import pytest

from slabcell_drivers.camera import CameraConfigError, CameraInfo, CameraLost, CameraState, ImageFrame
from slabcell_drivers.camera.probe import Sight
from slabcell_drivers.camera.settings import CameraStatistics
from slabcell_drivers.camera.supervision import SupervisedCamera

pytestmark = pytest.mark.unit

INFO = CameraInfo("slabcell", "test", "T-1", 64, 48, "Mono8")


class Refusing:
    """A backend whose camera is lost at the first picture, and refuses to be opened again so many times."""

    name = "T-1"

    def __init__(self, error: Callable[[], Exception], refusals: int) -> None:
        self._error = error
        self._refusals = refusals
        self._opened = 0

    async def look(self, timeout_s: float) -> Sight:
        return Sight.FREE

    async def prepare(self) -> None:
        pass

    async def connect(self) -> CameraInfo:
        self._opened += 1
        if 1 < self._opened <= 1 + self._refusals:
            raise self._error()
        return INFO

    async def shoot(self, deadline_s: float) -> ImageFrame:
        raise CameraLost("camera T-1: gone")

    async def disconnect(self, *, lost: bool) -> None:
        pass

    async def end(self, timeout_s: float) -> None:
        pass


@pytest.mark.parametrize(
    "error", [lambda: CameraConfigError("camera T-1: Width = 3 is refused"), lambda: KeyError("what a library may do")]
)
async def test_a_camera_that_refuses_is_asked_again_after_1_2_4_and_at_most_30_seconds(
    error: Callable[[], Exception],
) -> None:
    pauses: list[float] = []

    async def pause(seconds: float) -> None:
        pauses.append(seconds)
        await asyncio.sleep(0)

    camera = SupervisedCamera(Refusing(error, 8), CameraStatistics(), pause=pause)
    await camera.open(1.0)
    with pytest.raises(CameraLost):
        await camera.snap(1.0)
    assert "gone" in camera.cause
    async with asyncio.timeout(30.0):
        await camera.until(CameraState.READY)
    assert pauses == [1, 2, 4, 8, 16, 30, 30, 30]
    assert (camera.cause, camera.statistics.reconnects) == ("", 1)
    await camera.close()
