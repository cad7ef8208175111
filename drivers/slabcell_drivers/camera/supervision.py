"""How does a camera stay usable for months?  Deadlines, naming of what is lost, and reconnection, for any backend.

A backend knows how pictures are taken; this module decides how long it may take, looks at the camera beside it
(`probe`) to tell "no frame" from "no camera", and brings a lost camera back without anybody's help.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from typing import Final, Protocol, TypeVar

import structlog

from slabcell_drivers.camera.probe import Sight
from slabcell_drivers.camera.protocol import (
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraInfo,
    CameraLost,
    CameraState,
    CameraTimeout,
    ImageFrame,
)
from slabcell_drivers.camera.settings import CameraStatistics

__all__ = ["Backend", "SupervisedCamera"]

T = TypeVar("T")

_log = structlog.get_logger(__name__)

LOOK_S: Final = 0.5
"""A camera that answers, answers within milliseconds; this long is silence."""
WATCH_EVERY_S: Final = 0.4
"""Two looks without an answer mean that the camera is lost: with `LOOK_S` that is known within 2 s."""
RETRY_EVERY_S: Final = 0.2
CONNECT_S: Final = 10.0
CONNECT_TRIES: Final = 3
BACKOFF_S: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
DISCONNECT_S: Final = 10.0
_CLOSED: Final = "open it before a picture is taken"


class Backend(Protocol):
    """One way to reach a camera.  Calls may take longer than they should: the caller stops waiting."""

    @property
    def name(self) -> str:
        """What people call the camera."""
        ...

    async def look(self, timeout_s: float) -> Sight:
        """Say whether the camera answers, without the library that takes pictures."""
        ...

    async def connect(self) -> CameraInfo:
        """Take control, apply the settings, take a first picture.  Raises CameraError and leaves nothing open."""
        ...

    async def prepare(self) -> None:
        """Do what can be done while the camera is away, so that `connect` is quick when it is back."""
        ...

    async def shoot(self, deadline_s: float) -> ImageFrame:
        """Take one picture.  Raises CameraError."""
        ...

    async def disconnect(self, *, lost: bool) -> None:
        """Give the camera back, or give it up and forget where it was; may be called twice.  Raises CameraError."""
        ...

    async def end(self, timeout_s: float) -> None:
        """End threads and processes."""
        ...


class SupervisedCamera:
    """A `Camera` over a backend."""

    def __init__(
        self,
        backend: Backend,
        statistics: CameraStatistics,
        *,
        pause: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.statistics = statistics
        self._backend = backend
        self._pause = pause
        self._state = CameraState.CLOSED
        self._changed = asyncio.Event()
        self._cause = _CLOSED
        self._busy = asyncio.Lock()
        self._watcher: asyncio.Task[None] | None = None
        self._info: CameraInfo | None = None

    @property
    def state(self) -> CameraState:
        """Where the camera stands now."""
        return self._state

    @property
    def info(self) -> CameraInfo | None:
        """Who the camera is, None before it was opened."""
        return self._info

    @property
    def cause(self) -> str:
        """Why no picture can be taken now; empty while one can."""
        return "" if self._state is CameraState.READY else self._cause

    async def until(self, state: CameraState) -> None:
        """Wait until the camera stands so; it may be long."""
        while self._state is not state:
            await self._changed.wait()

    async def open(self, timeout_s: float) -> CameraInfo:
        """Connect, take control and apply the settings; waits for a camera that another client is about to leave.

        Once open, a camera that is lost is brought back by itself until `close`.  Raises CameraError.
        """
        await self.close()
        deadline_s = time.monotonic() + timeout_s
        self._become(CameraState.OPENING)
        try:
            self._info = await self._until_connected(deadline_s)
        except BaseException as error:
            self._become(CameraState.LOST)
            self._cause = str(error)
            await asyncio.shield(self._let_go(lost=True))
            await self._backend.end(DISCONNECT_S)
            raise
        self._become(CameraState.READY)
        self._watcher = asyncio.create_task(self._watch(), name=f"camera {self._backend.name}")
        return self._info

    async def snap(self, timeout_s: float) -> ImageFrame:
        """Trigger, and return the complete frame that was exposed after this call began.  Raises CameraError."""
        deadline_s = time.monotonic() + timeout_s
        try:
            async with asyncio.timeout(timeout_s):
                await self._busy.acquire()
        except TimeoutError as error:
            raise CameraTimeout(f"camera {self._backend.name}: was busy for {timeout_s:g} s") from error
        try:
            if self._state is not CameraState.READY:
                raise CameraLost(f"camera {self._backend.name}: is {self._state.value}: {self._cause}")
            frame = await self._snap(deadline_s, timeout_s)
        finally:
            self._busy.release()
        self.statistics.frames += 1
        self.statistics.latency_s = frame.received_s - frame.triggered_s
        return frame

    async def close(self) -> None:
        """Give the camera back; may be called twice."""
        watcher, self._watcher = self._watcher, None
        if watcher is not None:
            watcher.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await watcher
        was_ready = self._state is CameraState.READY
        self._become(CameraState.CLOSED)
        self._cause = _CLOSED
        await self._let_go(lost=not was_ready)
        await self._backend.end(DISCONNECT_S)

    async def _snap(self, deadline_s: float, timeout_s: float) -> ImageFrame:
        # The last part of the time is for finding out whether the camera is still there.
        look_s = min(LOOK_S, 0.3 * timeout_s)
        shot_s = deadline_s - look_s
        answer_s = deadline_s - min(0.01, 0.1 * look_s)  # the caller hears by the deadline, not just after it
        try:
            async with asyncio.timeout_at(_loop_time(shot_s + 0.5 * look_s)):
                return await self._backend.shoot(shot_s)
        except CameraLost as error:
            self._lose(str(error))
            raise
        except (TimeoutError, CameraTimeout) as error:
            sight = await self._backend.look(max(0.02, answer_s - time.monotonic()))
            if sight is not Sight.CONTROLLED:
                cause = f"camera {self._backend.name}: no longer ours, {sight.value}: check its power and its cable"
                self._lose(cause)
                raise CameraLost(cause) from error
            if isinstance(error, CameraTimeout):
                raise
            raise CameraTimeout(f"camera {self._backend.name}: no complete frame within {timeout_s:g} s") from error

    async def _until_connected(self, deadline_s: float) -> CameraInfo:
        """Connect as soon as the camera answers and is free.  Raises CameraError at the deadline."""
        sight = Sight.SILENT
        busy: CameraBusy | None = None
        lost = 0
        while (left_s := deadline_s - time.monotonic()) > 0:
            sight = await self._backend.look(min(LOOK_S, left_s))
            if sight is Sight.FREE:
                try:
                    async with asyncio.timeout_at(_loop_time(deadline_s)):
                        return await self._backend.connect()
                except CameraBusy as error:
                    busy, sight = error, Sight.CONTROLLED  # another client was quicker
                except CameraLost:
                    lost += 1
                    if lost == CONNECT_TRIES:
                        raise
                    sight = Sight.SILENT  # it answered a moment ago: a packet may have been lost
                except TimeoutError as error:
                    if busy is not None:
                        raise busy from error
                    raise CameraTimeout(f"camera {self._backend.name}: could not be set up in time") from error
            await asyncio.sleep(max(0.0, min(RETRY_EVERY_S, deadline_s - time.monotonic())))
        if sight is Sight.CONTROLLED:
            raise CameraBusy(
                f"camera {self._backend.name}: another client controls it; close that one, or wait for its heartbeat"
                " timeout to pass"
            )
        raise CameraLost(f"camera {self._backend.name}: does not answer: check its power, its cable and its address")

    def _become(self, state: CameraState) -> None:
        self._state = state
        self._changed.set()
        self._changed = asyncio.Event()

    def _lose(self, cause: str) -> None:
        if self._state is CameraState.READY:
            self._become(CameraState.LOST)
            self._cause = cause

    async def _watch(self) -> None:
        """Look at the idle camera now and then, and bring it back when it is lost."""
        silent = 0
        while True:
            if self._state is CameraState.LOST:
                await self._recover()
                silent = 0
            await asyncio.sleep(WATCH_EVERY_S if self._state is CameraState.READY else 0.0)
            if self._state is not CameraState.READY or self._busy.locked():
                continue
            sight = await self._backend.look(LOOK_S)
            silent = silent + 1 if sight is Sight.SILENT else 0
            if sight is Sight.FREE or silent >= 2:
                self._lose(f"camera {self._backend.name}: no longer ours, {sight.value}")

    async def _recover(self) -> None:
        """Bring a lost camera back, however long that takes."""
        known = self._info
        attempt = 0
        while True:
            await self._let_go(lost=True)
            try:
                await self._backend.prepare()
                found = await self._until_connected(time.monotonic() + CONNECT_S)
                _require_same(self._backend.name, known, found)
            except CameraError as error:
                self._cause = str(error)
            except Exception as error:  # noqa: BLE001 - logged, and tried again
                # Whatever a library does: the watch goes on, or nobody would bring the camera back.
                self._cause = f"camera {self._backend.name}: could not be opened again: {error!r}"
                _log.exception("camera cannot be opened again", camera=self._backend.name)
            else:
                self._info = found
                self.statistics.reconnects += 1
                self._become(CameraState.READY)
                return
            if await self._backend.look(LOOK_S) is not Sight.SILENT:
                # It is there and refuses: asking faster does not help.
                await self._let_go(lost=False)
                await self._pause(BACKOFF_S[min(attempt, len(BACKOFF_S) - 1)])
                attempt += 1

    async def _let_go(self, *, lost: bool) -> None:
        """Give the camera back or up; what a dead camera's library says to that changes nothing."""
        try:
            await self._within(DISCONNECT_S, self._backend.disconnect(lost=lost))
        except CameraError as error:
            _log.warning("camera could not be given back", camera=self._backend.name, error=str(error))

    async def _within(self, timeout_s: float, what: Awaitable[T]) -> T | None:
        """Wait for something that may hang, but not longer than this."""
        try:
            return await asyncio.wait_for(what, timeout_s)
        except TimeoutError:
            return None


def _loop_time(monotonic_s: float) -> float:
    """Return a monotonic time as the running loop counts it."""
    return asyncio.get_running_loop().time() + (monotonic_s - time.monotonic())


def _require_same(name: str, known: CameraInfo | None, found: CameraInfo) -> None:
    """Raise CameraConfigError unless the camera that came back is the one that was opened, set as it was."""
    if known is not None and found != known:
        raise CameraConfigError(
            f"camera {name}: what answers is {_described(found)}, opened was {_described(known)}; put back the camera"
            " that was there, or calibrate this one and start the cell again"
        )


def _described(info: CameraInfo) -> str:
    return f"{info.vendor} {info.model} {info.serial}, {info.pixel_format} of {info.width}x{info.height}"
