"""How is a camera opened through Harvesters and a GenTL producer?  Found, set and closed; its frames are the stream's.

Blocking, in a process of its own.  Harvesters' `stop` gives up half-way when the camera is gone; `close` does not.
"""

import time
from collections.abc import Sequence
from ipaddress import IPv4Address
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.features import apply_features, apply_settings, read_info
from slabcell_drivers.camera.genicam_binding import BUSY, LOST, ask, core, genapi, gentl
from slabcell_drivers.camera.harvesters_features import HarvestersFeatures
from slabcell_drivers.camera.harvesters_stream import HarvestersStream, RawFrame
from slabcell_drivers.camera.protocol import CameraBusy, CameraConfigError, CameraError, CameraInfo, CameraLost
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics
from slabcell_drivers.camera.taking import Taker

__all__ = ["HarvestersDevice"]

_PRIMING_S: Final = 6.0


class HarvestersDevice:
    """A camera behind a GenTL producer.  ``camera`` is a serial number, device id or user-defined name.

    ``serial`` is a serial number that is as good, for a producer that does not know the camera by ``camera``.
    ``memory`` is where the bytes of each frame are put.
    """

    def __init__(
        self,
        producers: Sequence[str],
        camera: str,
        serial: str,
        settings: CameraSettings,
        memory: npt.NDArray[np.uint8],
    ) -> None:
        self._camera = camera
        self._serial = serial
        self._settings = settings
        self._memory = memory
        self._acquirer: Any = None
        self._stream: HarvestersStream | None = None
        self._taker: Taker[RawFrame] | None = None
        self._harvester: Any = core.Harvester()
        for producer in producers:
            self._harvester.add_file(producer)
        self.statistics = CameraStatistics()

    def start(self) -> tuple[CameraInfo, str]:
        """Take control, apply the settings, take one picture; return who it is and its IP address, if it has one."""
        settings = self._settings
        try:
            self._harvester.update()
            self._acquirer = self._harvester.create(self._choose(), config=_config())
            self._acquirer.num_buffers = max(settings.buffers, self._acquirer.min_num_buffers)
            features = HarvestersFeatures(self._acquirer.remote_device.node_map, self._camera)
            apply_settings(features, settings, self._camera)
            for name, value in (("GevSCPSPacketSize", settings.packet_size), ("GevSCPD", settings.packet_delay_ns)):
                if value is not None:
                    features.set(name, value)
            apply_features(features, settings)
            info = read_info(features, self._camera)
            self._stream = HarvestersStream(self._acquirer, self._camera, info, self._memory, self.statistics)
            self._taker = Taker(self._stream, self.statistics)
            self._stream.start()
            self._taker.prime(time.monotonic() + _PRIMING_S)
        except (gentl.GenericException, genapi.GenericException) as error:
            raise self._named(error) from error
        return info, _address(features)

    def snap(self, deadline_s: float) -> RawFrame:
        """Trigger and return the frame; one bad frame is taken again while there is time.  Raises CameraError."""
        if self._stream is None or self._taker is None:
            raise CameraLost(f"camera {self._camera}: is not open")
        try:
            return self._taker.snap(deadline_s)
        except (gentl.GenericException, genapi.GenericException) as error:
            raise self._named(error) from error
        finally:
            self._stream.count()

    def close(self) -> None:
        """Give the camera back.  Raises nothing that the producer raises: the process ends next."""
        if self._acquirer is not None:
            try:
                self._acquirer.stop()
                self._acquirer.destroy()
            except (gentl.GenericException, genapi.GenericException):
                # The camera has gone; `stop` leaves the streams running, and only they can still be stopped.
                self._kill_streams()
            self._acquirer = self._stream = self._taker = None
        self._harvester.reset()

    def _kill_streams(self) -> None:
        flags = gentl.ACQ_STOP_FLAGS_LIST.ACQ_STOP_FLAGS_KILL
        for stream in self._acquirer.data_streams:
            try:
                stream.stop_acquisition(flags)
            except gentl.GenericException:
                continue  # it was stopped already, or the producer has given it up

    def _choose(self) -> int:
        """Return the place of the wanted camera in the producer's list.  Raises CameraLost."""
        names = [
            [ask(device, name) for name in ("serial_number", "id_", "user_defined_name")]
            for device in self._harvester.device_info_list
        ]
        # A producer that knows cameras by address is asked by address only: serial numbers are unique to one maker.
        by_address = _is_address(self._camera) and any(_is_address(found[1]) for found in names)
        for wanted in (self._camera,) if by_address else (self._camera, self._serial):
            for index, found in enumerate(names):
                if wanted in found:
                    return index
        seen = [str(found[0] or found[1]) for found in names]
        raise CameraLost(
            f"camera {self._camera}: is not among the cameras of {', '.join(self._harvester.files) or 'no producer'}:"
            f" {', '.join(seen) or 'there is none'}"
        )

    def _named(self, error: Exception) -> CameraError:
        name = type(error).__name__
        if name in BUSY or "privilege" in str(error):
            return CameraBusy(f"camera {self._camera}: another client controls it ({error})")
        if name in LOST or "imeout" in str(error):
            return CameraLost(f"camera {self._camera}: no longer answers: check its power and its cable ({error})")
        return CameraConfigError(f"camera {self._camera}: {name}: {error}")


def _config() -> Any:
    # Chunks are not used, and some producers answer with errors when asked for them at every frame.
    return core.ParameterSet({core.ParameterKey.ENABLE_AUTO_CHUNK_DATA_UPDATE: False})


def _address(features: HarvestersFeatures) -> str:
    """Return the camera's IPv4 address, empty if it has none that it tells."""
    if not features.has("GevCurrentIPAddress"):
        return ""
    return str(IPv4Address(int(features.get("GevCurrentIPAddress"))))


def _is_address(text: object) -> bool:
    try:
        IPv4Address(str(text))
    except ValueError:
        return False
    return True
