"""How is a GigE Vision camera of any make used without its vendor's SDK?  Straight through libaravis 0.8.

One worker thread owns the library's objects.  This module is *not* responsible for reconnecting (`supervision`), for
what a picture's bytes mean (`pixel_formats`) or for the calls themselves (`aravis_device`).
"""

import asyncio
from collections.abc import Sequence
from ipaddress import IPv4Address
from typing import Final

import structlog

from slabcell_drivers.camera.aravis_device import AravisDevice
from slabcell_drivers.camera.aravis_library import AravisLibrary
from slabcell_drivers.camera.discovery import Interface, find_camera
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.camera.protocol import CameraInfo, CameraLost, ImageFrame
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics, FeatureValue
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.camera.worker import Worker

__all__ = ["AravisCamera"]

SEARCH_S: Final = 0.3

_log = structlog.get_logger(__name__)


class AravisCamera(SupervisedCamera):
    """The camera with this IPv4 address, or with this serial number, MAC address or user-defined name.

    A name is looked for with broadcasts, on all interfaces or those given.  Raises AravisMissingError if the library is
    not installed.
    """

    def __init__(
        self,
        camera: str,
        settings: CameraSettings | None = None,
        *,
        on: Sequence[Interface] | None = None,
    ) -> None:
        statistics = CameraStatistics()
        self._aravis = _AravisBackend(camera, settings or CameraSettings(), statistics, on)
        super().__init__(self._aravis, statistics)

    async def read(self, *names: str) -> dict[str, FeatureValue]:
        """Return GenICam features of the open camera by name.  Raises CameraError."""
        return await self._aravis.read(names)


class _AravisBackend:
    def __init__(
        self, camera: str, settings: CameraSettings, statistics: CameraStatistics, on: Sequence[Interface] | None
    ) -> None:
        self.name = camera
        self._settings = settings
        self._statistics = statistics
        self._on = on
        self._library = AravisLibrary()
        self._address: str | None = camera if _is_address(camera) else None
        self._worker = Worker(f"aravis-{camera}")
        self._device: AravisDevice | None = None

    async def look(self, timeout_s: float) -> Sight:
        if self._address is None:
            found = await asyncio.to_thread(find_camera, self.name, min(SEARCH_S, timeout_s), on=self._on)
            if found is None:
                return Sight.SILENT
            self._address = str(found.address)
        sight = await look(self._address, timeout_s)
        if sight is Sight.SILENT and not _is_address(self.name):
            self._address = None  # it may have another address when it comes back
        return sight

    async def prepare(self) -> None:
        pass  # connecting is quick

    async def connect(self) -> CameraInfo:
        address = self._address
        if address is None:
            raise CameraLost(f"camera {self.name}: is not found on the network")
        device = AravisDevice(self._library, address, self._settings, self._statistics)

        def connect() -> CameraInfo:
            try:
                device.connect()
                info = device.start()
                self._warn_of_small_buffer(device.payload_bytes())
            except CameraLost:
                device.abandon()
                raise
            except BaseException:
                device.close()
                raise
            return info

        self._device = device
        return await self._worker.call(connect)

    async def shoot(self, deadline_s: float) -> ImageFrame:
        device = self._device
        if device is None:
            raise CameraLost(f"camera {self.name}: is not connected")
        return await self._worker.call(lambda: device.snap(deadline_s))

    async def read(self, names: Sequence[str]) -> dict[str, FeatureValue]:
        device = self._device
        if device is None:
            raise CameraLost(f"camera {self.name}: is not connected")
        return await self._worker.call(lambda: {name: device.features.get(name) for name in names})

    async def disconnect(self, *, lost: bool) -> None:
        device, self._device = self._device, None
        if lost and not _is_address(self.name):
            self._address = None  # it may have another address when it comes back, and another camera this one
        if device is not None:
            await self._worker.call(device.abandon if lost else device.close)

    def _warn_of_small_buffer(self, frame_bytes: int) -> None:
        granted = self._statistics.socket_buffer_bytes
        if 0 < granted < frame_bytes:
            _log.warning(
                "socket buffer is smaller than a frame: packets are lost when this machine is busy",
                camera=self.name, granted_bytes=granted, frame_bytes=frame_bytes,
                remedy="sudo sysctl -w net.core.rmem_max=33554432",
            )  # fmt: skip

    async def end(self, timeout_s: float) -> None:
        await self._worker.close(timeout_s)


def _is_address(text: str) -> bool:
    try:
        IPv4Address(text)
    except ValueError:
        return False
    return True
