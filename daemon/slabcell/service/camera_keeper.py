"""Is the camera there?  Opens it in the background, and says when it is lost and when it is back.

A driver of a real camera brings a lost one back by itself once it has been open; any other is opened again here.
A camera that is not the calibrated one is closed again, and the cell halts: no pose may come from it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator

import structlog

from slabcell.calibration import Calibration, CameraIdentity
from slabcell.catalogue import Fault
from slabcell.cell.cell import Cell
from slabcell.errors import CalibrationError
from slabcell.service.links import LinkName, Links, LinkState
from slabcell_drivers.camera import Camera, CameraBusy, CameraConfigError, CameraError
from slabcell_drivers.camera.protocol import CameraInfo, CameraState
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.light import LitCamera

__all__ = ["CameraKeeper"]

OPEN_TIMEOUT_S = 10.0
LOOK_EVERY_S = 0.1
BACKOFF_S = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)

_log = structlog.get_logger(__name__)

_OPEN_FAULTS: tuple[tuple[type[CameraError], Fault], ...] = (
    (CameraBusy, Fault.CAMERA_BUSY),
    (CameraConfigError, Fault.CAMERA_SETTING),
    (CameraError, Fault.CAMERA_LOST),
)
_KEPT_FAULTS = tuple(fault for _, fault in _OPEN_FAULTS)


class CameraKeeper:
    """Keeps one camera open for one cell, from `run` until it is cancelled.

    ``calibration`` is asked at each opening, because another may be in use by then.
    """

    def __init__(self, camera: Camera, cell: Cell, links: Links, calibration: Callable[[], Calibration | None]) -> None:
        self.info: CameraInfo | None = None
        """Who the camera is, once it was open."""
        self._camera = camera
        self._cell = cell
        self._links = links
        self._calibration = calibration

    async def run(self) -> None:
        """Open the camera, watch it, and open it again, until cancelled."""
        pauses = _backoff()
        while True:
            try:
                self.info = info = await self._camera.open(OPEN_TIMEOUT_S)
            except CameraError as error:
                pause_s = next(pauses)
                _log.warning("camera not open", error=str(error), next_try_s=pause_s)
                fault = next(fault for kind, fault in _OPEN_FAULTS if isinstance(error, kind))
                self._down(fault, str(error))
                await asyncio.sleep(pause_s)
                continue
            pauses = _backoff()
            _log.info("camera open", model=info.model, serial=info.serial, width=info.width, height=info.height)
            if not await self._is_calibrated(info):
                return
            self._up(info)
            await self._watch(info)

    async def _is_calibrated(self, info: CameraInfo) -> bool:
        calibration = self._calibration()
        if calibration is None:  # its pictures are needed for the first one
            return True
        identity = CameraIdentity(info.width, info.height, info.serial)
        try:
            calibration.require_camera(identity, f"camera {info.serial}")
        except CalibrationError as error:
            _log.exception("camera refused")
            await self._camera.close()
            self._links.set(LinkName.CAMERA, LinkState.DOWN, str(error))
            self._cell.alarms.come(Fault.CALIBRATION_MISMATCH, str(error))
            await self._cell.halt(str(error))
            return False
        return True

    async def _watch(self, info: CameraInfo) -> None:
        """Follow the driver's own word; returns when the camera has to be opened again."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            if self._camera.state is CameraState.READY:
                self._up(info)
                continue
            driver = self._camera.camera if isinstance(self._camera, LitCamera) else self._camera
            cause = driver.cause if isinstance(driver, SupervisedCamera) else ""
            self._down(Fault.CAMERA_LOST, cause or f"camera {info.serial} is {self._camera.state.value}")
            if not isinstance(driver, SupervisedCamera):
                return

    def _up(self, info: CameraInfo) -> None:
        detail = f"{info.vendor} {info.model} {info.serial}, {info.width}x{info.height} {info.pixel_format}"
        if self._links.set(LinkName.CAMERA, LinkState.UP, detail):
            self._cell.alarms.cease(*_KEPT_FAULTS)

    def _down(self, fault: Fault, detail: str) -> None:
        self._links.set(LinkName.CAMERA, LinkState.DOWN, detail)
        self._cell.alarms.cease(*(other for other in _KEPT_FAULTS if other is not fault))
        self._cell.alarms.come(fault, detail)


def _backoff() -> Generator[float]:
    yield from BACKOFF_S
    while True:
        yield BACKOFF_S[-1]
