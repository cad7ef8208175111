"""How does a camera behave that looks at the simulated world?  Like a real one, faults included.

It renders on a worker thread, and is *not* responsible for what a picture shows: that is the function it is given.
Faults are switched on and off by a test or a person; each is what a real camera does when that happens to it.
"""

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.protocol import (
    CameraBusy,
    CameraConfigError,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    CameraState,
    CameraTimeout,
    ImageFrame,
    Pixels,
)

__all__ = ["CameraFault", "Render", "SimulatedCamera"]

Render = Callable[[int], Pixels]
"""Returns what the camera sees now; it is given the number of the frame and runs on a worker thread."""


class CameraFault(StrEnum):
    """What can be wrong with a camera."""

    OFF = "off"  # no power or no cable: nothing answers
    BUSY = "busy"  # another program controls it
    HANG = "hang"  # it takes commands and never comes back
    DROP = "drop"  # triggered, but no frame comes
    INCOMPLETE = "incomplete"  # packets of the frame are lost
    DARK = "dark"  # the light is out
    BLUR = "blur"  # out of focus
    STUCK = "stuck"  # it answers, but every frame is the one from before
    DELAYED = "delayed"  # frames come late


@dataclass(slots=True)
class _Fault:
    left: int | None
    delay_s: float


class SimulatedCamera:
    """A `Camera` whose pictures are rendered.  Device time counts from the camera's start, in ns."""

    def __init__(self, info: CameraInfo, render: Render) -> None:
        self.info = info
        self._render = render
        self._state = CameraState.CLOSED
        self._frame_id = 0
        self._faults: dict[CameraFault, _Fault] = {}
        self._last: Pixels | None = None
        self._started_ns = time.monotonic_ns()
        self._busy = asyncio.Lock()

    @property
    def state(self) -> CameraState:
        """Where the camera stands now."""
        return self._state

    def break_with(self, fault: CameraFault, *, frames: int | None = None, delay_s: float = 0.0) -> None:
        """Switch a fault on, for so many frames or until `mend`; ``delay_s`` is what ``DELAYED`` adds to a frame."""
        self._faults[fault] = _Fault(frames, delay_s)

    def mend(self, fault: CameraFault | None = None) -> None:
        """Switch a fault off, or all of them."""
        if fault is None:
            self._faults.clear()
        else:
            self._faults.pop(fault, None)

    async def open(self, timeout_s: float) -> CameraInfo:
        """Connect; the camera counts its frames from 1 again.  Raises `CameraError`."""
        self._state = CameraState.OPENING
        try:
            await asyncio.sleep(timeout_s if CameraFault.HANG in self._faults else 0.0)
            self._check_it_answers(timeout_s)
        except BaseException:
            self._state = CameraState.LOST
            raise
        self._frame_id = 0
        self._state = CameraState.READY
        return self.info

    async def snap(self, timeout_s: float) -> ImageFrame:
        """Take a picture of the world as it is from now on.  Raises `CameraError`."""
        deadline = time.monotonic() + timeout_s
        try:
            async with asyncio.timeout(timeout_s), self._busy:
                return await self._snap(deadline)
        except TimeoutError as error:
            msg = f"{self._name}: no complete frame within {timeout_s:g} s of the trigger"
            raise CameraTimeout(msg) from error

    async def close(self) -> None:
        """Give the camera back; may be called twice."""
        self._state = CameraState.CLOSED

    def _check_it_answers(self, timeout_s: float) -> None:
        if CameraFault.HANG in self._faults:
            msg = f"{self._name}: no answer within {timeout_s:g} s: switch it off and on"
            raise CameraTimeout(msg)
        if CameraFault.OFF in self._faults:
            msg = f"{self._name}: does not answer within {timeout_s:g} s: check its power and its cable"
            raise CameraLost(msg)
        if CameraFault.BUSY in self._faults:
            msg = f"{self._name}: is controlled by another program: close that one, or wait for its heartbeat to end"
            raise CameraBusy(msg)

    @property
    def _name(self) -> str:
        return f"camera {self.info.serial}"

    def _is(self, fault: CameraFault) -> _Fault | None:
        """Return the fault if it is on, and count it down."""
        found = self._faults.get(fault)
        if found is not None and found.left is not None:
            found.left -= 1
            if found.left <= 0:
                del self._faults[fault]
        return found

    def _check_picture(self, pixels: Pixels) -> None:
        """Raise CameraConfigError unless a picture is as the camera says its pictures are."""
        if pixels.shape[:2] != (self.info.height, self.info.width):
            msg = (
                f"{self._name}: the picture has {pixels.shape[1]}x{pixels.shape[0]} pixels, "
                f"the camera is set to {self.info.width}x{self.info.height}"
            )
            raise CameraConfigError(msg)
        kind = "BGR8" if pixels.ndim == 3 else "Mono8" if pixels.dtype == np.uint8 else "Mono16"
        said = self.info.pixel_format
        if said != kind and not (kind == "Mono16" and said in ("Mono10", "Mono12")):
            msg = f"{self._name}: the picture is {kind}, the camera is set to {said}"
            raise CameraConfigError(msg)

    async def _snap(self, deadline: float) -> ImageFrame:
        if self._state is CameraState.CLOSED:
            msg = f"{self._name}: is not open: open it before a picture is taken"
            raise CameraLost(msg)
        if self._is(CameraFault.OFF) or self._state is CameraState.LOST:
            self._state = CameraState.LOST
            msg = f"{self._name}: no longer answers: check its power and its cable, then open it again"
            raise CameraLost(msg)
        triggered_s = time.monotonic()
        self._frame_id += 1
        frame_id = self._frame_id
        if self._is(CameraFault.DROP) or self._is(CameraFault.HANG):
            await asyncio.sleep(max(0.0, deadline - time.monotonic()) + 60.0)
        delayed = self._is(CameraFault.DELAYED)
        if delayed is not None:
            await asyncio.sleep(delayed.delay_s)
        stuck = self._is(CameraFault.STUCK)
        if stuck is not None and self._last is not None:
            pixels = self._last.copy()
        else:
            pixels = await asyncio.to_thread(self._render, frame_id)
        if self._is(CameraFault.INCOMPLETE):
            msg = f"{self._name}: frame {frame_id} is incomplete: packets were lost; check network and packet size"
            raise CameraIncomplete(msg)
        self._check_picture(pixels)
        if self._is(CameraFault.DARK):
            pixels = _alike(pixels // 24, pixels)
        if self._is(CameraFault.BLUR):
            pixels = _alike(cv2.GaussianBlur(pixels, (0, 0), 6.0), pixels)
        self._last = pixels
        received_s = time.monotonic()
        return ImageFrame(
            pixels.copy(),
            self.info.pixel_format,
            frame_id,
            triggered_s,
            received_s,
            time.monotonic_ns() - self._started_ns,
        )


def _alike(values: npt.ArrayLike, pixels: Pixels) -> Pixels:
    """Return values as pixels of the same depth."""
    return np.asarray(values, np.uint16) if pixels.dtype == np.uint16 else np.asarray(values, np.uint8)
