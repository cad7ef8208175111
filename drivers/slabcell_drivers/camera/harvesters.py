"""How is any camera with a GenTL producer used?  Through Harvesters, in a child process that may hang or crash.

The genicam binding holds Python's global lock while a producer waits for a dead camera, so it must not live in the
daemon.  Each connection has a process of its own: what a producer leaks, ends with it.  This module is *not*
responsible for reconnecting (`supervision`), for talking to the process (`harvesters_process`) or for the calls
themselves (`harvesters_device`).
"""

import asyncio
import contextlib
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from ipaddress import IPv4Address
from pathlib import Path
from typing import Final

from slabcell_drivers.camera.discovery import Interface, find_camera
from slabcell_drivers.camera.harvesters_process import HarvestersProcess
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.camera.protocol import CameraConfigError, CameraError, CameraInfo, CameraLost, ImageFrame
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.gentl import ProducerBuildError, build

__all__ = ["HarvestersCamera", "producers_of_environment"]

PRODUCERS_VARIABLE: Final = "GENICAM_GENTL64_PATH"
CLOSE_S: Final = 3.0
SEARCH_S: Final = 0.3


def producers_of_environment() -> tuple[Path, ...]:
    """Return the producers (.cti) in the folders that GENICAM_GENTL64_PATH names, as vendors' installers set it."""
    folders = [Path(text) for text in os.environ.get(PRODUCERS_VARIABLE, "").split(os.pathsep) if text]
    return tuple(path for folder in folders for path in sorted(folder.glob("*.cti")))


class HarvestersCamera(SupervisedCamera):
    """The camera with this serial number, device id, user-defined name or, for GigE Vision, IPv4 address.

    ``producers`` are the .cti files to look in; the default are those that GENICAM_GENTL64_PATH leads to, and without
    any our own over Aravis, which is built when it is first needed.
    """

    def __init__(
        self,
        camera: str,
        producers: Sequence[Path] | None = None,
        settings: CameraSettings | None = None,
        *,
        on: Sequence[Interface] | None = None,
    ) -> None:
        statistics = CameraStatistics()
        chosen = tuple(producers) if producers is not None else producers_of_environment()
        self._harvesters = _HarvestersBackend(camera, chosen, settings or CameraSettings(), statistics, on)
        super().__init__(self._harvesters, statistics)

    @property
    def process_id(self) -> int | None:
        """The process that holds the producer, None if there is none now."""
        return self._harvesters.process_id


class _HarvestersBackend:
    def __init__(
        self,
        camera: str,
        producers: tuple[Path, ...],
        settings: CameraSettings,
        statistics: CameraStatistics,
        on: Sequence[Interface] | None,
    ) -> None:
        self.name = camera
        self._producers = producers
        self._settings = settings
        self._statistics = statistics
        self._on = on
        self._child: HarvestersProcess | None = None
        self._spare: HarvestersProcess | None = None
        self._info: CameraInfo | None = None
        self._address = ""
        self._counted: dict[str, int] = {}
        self._connected = False

    @property
    def process_id(self) -> int | None:
        return self._child.process_id if self._child else None

    async def look(self, timeout_s: float) -> Sight:
        if self._child is not None and not self._child.alive:
            self._connected = False
            return Sight.SILENT
        if self._address:
            return await look(self._address, timeout_s)
        return Sight.CONTROLLED if self._connected else Sight.FREE

    async def prepare(self) -> None:
        """Have a process ready, its libraries loaded, for when the camera is back."""
        self._spare = await self._process()

    async def connect(self) -> CameraInfo:
        producers = await self._existing_producers()
        serial, address = await self._found()
        await self._drop()
        child = self._child = await self._process()
        try:
            found = await child.ask(
                "start",
                producers=[str(path) for path in producers],
                camera=self.name,
                serial=serial,
                address=address,
                settings=asdict(self._settings),
            )
        except BaseException:
            await self._drop()
            raise
        self._address = found.pop("address")
        self._info = CameraInfo(**found)
        self._connected = True
        return self._info

    async def shoot(self, deadline_s: float) -> ImageFrame:
        child, info = self._child, self._info
        if child is None or info is None:
            raise CameraLost(f"camera {self.name}: is not connected")
        try:
            found = await child.ask("snap", deadline_s=deadline_s)
        finally:
            self._count(child.counts)
        pixels = await asyncio.to_thread(child.pixels, found["size"], info)
        received_s = time.monotonic()
        return ImageFrame(
            pixels,
            info.pixel_format,
            found["frame_id"],
            found["triggered_s"],
            received_s,
            found["device_timestamp_ns"],
            found["said"],
        )

    async def disconnect(self, *, lost: bool) -> None:
        child = self._child
        if child is not None and not lost and child.alive:
            with contextlib.suppress(CameraError, TimeoutError):  # it is ended in any case
                await asyncio.wait_for(child.ask("close"), CLOSE_S)
        await self._drop()

    async def end(self, timeout_s: float) -> None:
        del timeout_s
        self._address = ""
        await self._drop()
        spare, self._spare = self._spare, None
        if spare is not None:
            await spare.end()

    async def _process(self) -> HarvestersProcess:
        """Return a process that holds no camera: the one that was kept ready, or a new one."""
        spare, self._spare = self._spare, None
        if spare is not None and spare.alive:
            return spare
        if spare is not None:
            await spare.end()
        return await HarvestersProcess.start(self.name)

    async def _drop(self) -> None:
        child, self._child = self._child, None
        self._connected = False
        self._counted = {}
        if child is not None:
            await child.end()

    async def _existing_producers(self) -> tuple[Path, ...]:
        """Return the producers to load, ours if there is no other.  Raises CameraConfigError."""
        if not self._producers:
            try:
                self._producers = (await asyncio.to_thread(build),)
            except ProducerBuildError as error:
                raise CameraConfigError(
                    f"camera {self.name}: no GenTL producer (.cti) is given, {PRODUCERS_VARIABLE} leads to none, and"
                    f" {error}"
                ) from error
        missing = [str(path) for path in self._producers if not path.is_file()]
        if missing:
            raise CameraConfigError(
                f"camera {self.name}: there is no GenTL producer {', '.join(missing)}; give the path of the .cti file"
                f" that the camera's vendor installs, or none at all"
            )
        return self._producers

    async def _found(self) -> tuple[str, str]:
        """Return serial number and IPv4 address of the camera; the name and nothing if it is not seen by GigE Vision.

        Raises CameraLost if there is nobody at the address that is its name.
        """
        found = await asyncio.to_thread(find_camera, self.name, SEARCH_S, on=self._on)
        if found is not None:
            return found.serial, str(found.address)
        try:
            IPv4Address(self.name)
        except ValueError:
            return self.name, ""
        raise CameraLost(f"camera {self.name}: does not answer: check its power, its cable and its address")

    def _count(self, counts: Mapping[str, int | float]) -> None:
        """Take over what the process counted since it was last asked."""
        for name in ("incomplete", "timeouts", "stale", "gaps", "retries", "restarts", "underruns"):
            seen = int(counts.get(name, 0))
            grown = seen - self._counted.get(name, 0)
            setattr(self._statistics, name, getattr(self._statistics, name) + grown)
            self._counted[name] = seen
