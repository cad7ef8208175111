"""Which camera looks at the simulated world?  The simulated one, or a real driver on a GigE Vision camera in software.

With a real driver every picture crosses the GigE Vision protocol on the loopback interface: discovery, control,
trigger and stream are those of a camera on a cable.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from enum import StrEnum

from slabcell.errors import UnavailableError
from slabcell.service.simulated import SimulatedCell
from slabcell_drivers.camera import Camera, CameraError
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_library import AravisMissingError
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.settings import CameraSettings
from slabcell_drivers.simulation.gige import GigeCamera, GigeCameraError, SensorLimits

__all__ = ["DemoCamera", "demo_camera"]

OPEN_TIMEOUT_S = 10.0
ADDRESSES = tuple(f"127.0.0.{host}" for host in range(1, 10))
PACKET_BYTES = 8000  # what a network set up for cameras carries (jumbo frames)


class DemoCamera(StrEnum):
    """The drivers that the demo can show."""

    SIMULATED = "simulated"
    ARAVIS = "aravis"
    HARVESTERS = "harvesters"


@contextlib.asynccontextmanager
async def demo_camera(kind: DemoCamera, cell: SimulatedCell) -> AsyncGenerator[Camera]:
    """Open the camera, and close it in the end.  Raises UnavailableError that says what is missing."""
    with contextlib.ExitStack() as stack:
        try:
            camera = _make(kind, cell, stack)
            await camera.open(OPEN_TIMEOUT_S)
        except (CameraError, GigeCameraError, AravisMissingError) as error:
            msg = f"camera {kind.value}: {error}"
            raise UnavailableError(msg) from error
        try:
            yield camera
        finally:
            await camera.close()


def _make(kind: DemoCamera, cell: SimulatedCell, stack: contextlib.ExitStack) -> Camera:
    if kind is DemoCamera.SIMULATED:
        return cell.camera
    gige = _switch_on(cell, stack)
    settings = CameraSettings(packet_size=PACKET_BYTES)
    if kind is DemoCamera.ARAVIS:
        return AravisCamera(gige.address, settings)
    # No producer named: those of GENICAM_GENTL64_PATH, else our own, which is built when it is first needed.
    return HarvestersCamera(gige.device.serial, None, settings)


def _switch_on(cell: SimulatedCell, stack: contextlib.ExitStack) -> GigeCamera:
    """Return a GigE Vision camera that sees the world, at the first loopback address that is free."""
    spec = cell.scene.camera
    limits = SensorLimits(spec.width, spec.height)
    for last, address in enumerate(ADDRESSES, start=1):
        camera = GigeCamera(
            cell.picture, address, serial=spec.serial, vendor=spec.vendor, model=spec.model, limits=limits
        )
        try:
            return stack.enter_context(camera)
        except GigeCameraError:
            if last == len(ADDRESSES):
                raise
    raise AssertionError  # the loop returns or raises
