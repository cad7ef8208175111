"""How does the light go with the pictures?  `LitCamera`: a camera whose light is set, switched and watched with it.

``continuous``: the light shines while the camera is open.  ``with-trigger``: it is switched on before each picture and
off after it.  ``strobe``: it is set to pulse, and the camera's own output starts the pulse on the controller's input,
in step with the exposure to microseconds; ``trigger_by_command`` has the pulse started by a command instead, just after
the camera is triggered, for tests without that wire.

No picture is taken without its light: if the controller cannot be reached the picture fails as `CameraUnlit`.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from enum import StrEnum

import structlog

from slabcell_drivers.camera.protocol import Camera, CameraInfo, CameraState, CameraUnlit, ImageFrame
from slabcell_drivers.light.protocol import Light, LightError, LightSetting

__all__ = ["LightMode", "LightPlan", "LitCamera"]

CHECK_EVERY_S = 0.5

_log = structlog.get_logger(__name__)


class LightMode(StrEnum):
    """When the light shines."""

    CONTINUOUS = "continuous"
    WITH_TRIGGER = "with-trigger"
    STROBE = "strobe"


@dataclass(frozen=True, slots=True)
class LightPlan:
    """What shines when; ``settle_s`` is waited between switching on and the picture."""

    mode: LightMode = LightMode.CONTINUOUS
    settings: tuple[LightSetting, ...] = field(default_factory=lambda: (LightSetting(),))
    settle_s: float = 0.02
    trigger_by_command: bool = False


class LitCamera:
    """A `Camera` with its light.

    ``on_light`` is told, in the event loop, of each change: nothing when the controller answers, and why not otherwise.
    """

    def __init__(self, camera: Camera, light: Light, plan: LightPlan, on_light: Callable[[str], None]) -> None:
        self._camera, self._light, self._plan = camera, light, plan
        self._on_light = on_light
        self._trouble: str | None = "not connected yet"
        self._opened = False
        self._turn = asyncio.Lock()
        self._watching: asyncio.Task[None] | None = None

    @property
    def state(self) -> CameraState:
        """Where the camera stands now; its light has a word of its own."""
        return self._camera.state

    @property
    def camera(self) -> Camera:
        """The camera itself."""
        return self._camera

    def watch(self) -> None:
        """Begin to look after the light: connect it, name a loss, connect it again."""
        if self._watching is None:
            self._watching = asyncio.get_running_loop().create_task(self._watch(), name="slabcell-light")

    async def open(self, timeout_s: float) -> CameraInfo:
        """Connect the camera; the light is looked after beside it."""
        self.watch()
        return await self._camera.open(timeout_s)

    async def snap(self, timeout_s: float) -> ImageFrame:
        """Take one picture in its light.  Raises CameraError."""
        plan = self._plan
        async with self._turn:
            await self._guarded(self._prepare())
            try:
                if plan.trigger_by_command:
                    return await self._snap_and_trigger(timeout_s)
                return await self._camera.snap(timeout_s)
            finally:
                if plan.mode is LightMode.WITH_TRIGGER:
                    with contextlib.suppress(CameraUnlit):  # the picture is good; the watch names the loss
                        await self._guarded(self._switch_off())

    async def close(self) -> None:
        """Turn the light off and give camera and light back; may be called twice."""
        watching, self._watching = self._watching, None
        if watching is not None:
            watching.cancel()
            await asyncio.gather(watching, return_exceptions=True)
            async with self._turn:
                with contextlib.suppress(CameraUnlit):
                    await self._guarded(self._switch_off())
                await self._light.close()
        await self._camera.close()

    async def _prepare(self) -> None:
        if self._plan.mode is LightMode.WITH_TRIGGER:
            for setting in self._plan.settings:
                await self._light.on(setting)
            await asyncio.sleep(self._plan.settle_s)
        elif self._trouble is not None:
            await self._look_after()  # perhaps it has just come back

    async def _set_up(self) -> None:
        if self._plan.mode is not LightMode.WITH_TRIGGER:
            for setting in self._plan.settings:
                await self._light.on(setting)

    async def _switch_off(self) -> None:
        for setting in self._plan.settings:
            await self._light.off(setting.channel)

    async def _snap_and_trigger(self, timeout_s: float) -> ImageFrame:
        snapping = asyncio.ensure_future(self._camera.snap(timeout_s))
        try:
            await asyncio.sleep(0)  # the camera's trigger goes first
            for setting in self._plan.settings:
                await self._guarded(self._light.trigger(setting.channel))
            return await snapping
        finally:
            if not snapping.done():
                snapping.cancel()
                await asyncio.gather(snapping, return_exceptions=True)

    async def _guarded(self, work: Awaitable[None]) -> None:
        try:
            await work
        except LightError as error:
            self._tell(str(error))
            raise CameraUnlit(f"no picture without its light: {error}") from error
        self._tell(None)

    def _tell(self, trouble: str | None) -> None:
        before, self._trouble = self._trouble, trouble
        if trouble != before:
            _log.info("light.state", trouble=trouble or "")
            self._on_light(trouble or "")

    async def _watch(self) -> None:
        while True:
            async with self._turn:
                with contextlib.suppress(CameraUnlit):
                    await self._guarded(self._look_after())
            await asyncio.sleep(CHECK_EVERY_S)

    async def _look_after(self) -> None:
        if not self._opened:
            await self._light.open()
            self._opened = True
            await self._set_up()
        else:
            await self._light.check()
            if self._trouble is not None:
                await self._set_up()
