"""How is a camera opened and set through libaravis?  Control, settings, packets; its frames are `aravis_stream`'s.

Everything here blocks, on the one thread that owns the camera; `aravis` puts asyncio in front of it.
"""

import time
from pathlib import Path
from typing import Final

from slabcell_drivers.camera.aravis_features import Features
from slabcell_drivers.camera.aravis_library import AravisError, AravisLibrary, DeviceFault, Pointer, StreamOption
from slabcell_drivers.camera.aravis_stream import AravisStream
from slabcell_drivers.camera.features import apply_features, apply_settings, read_info
from slabcell_drivers.camera.protocol import (
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    ImageFrame,
)
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics
from slabcell_drivers.camera.taking import Taker

__all__ = ["AravisDevice", "kernel_buffer_limit"]

_NEVER_ADJUST: Final = 0
_SMALL_PACKET: Final = 1500
_AUTO_DELAY_NS: Final = 50_000
_PRIMING_S: Final = 6.0
_RMEM_MAX: Final = Path("/proc/sys/net/core/rmem_max")


class AravisDevice:
    """A camera that this process controls and that waits for triggers.  ``address`` is an IPv4 address."""

    def __init__(
        self, library: AravisLibrary, address: str, settings: CameraSettings, statistics: CameraStatistics
    ) -> None:
        self._library = library
        self._address = address
        self._settings = settings
        self._statistics = statistics
        self._camera: Pointer = 0
        self._features: Features | None = None
        self._stream: AravisStream | None = None
        self._taker: Taker[ImageFrame] | None = None

    @property
    def features(self) -> Features:
        """The camera's features.  Raises CameraLost if it is not open."""
        if self._features is None:
            raise CameraLost(f"camera {self._address}: is not open")
        return self._features

    def connect(self, *, control: bool = True) -> None:
        """Take control of the camera, or only read what may be read.  Raises CameraError."""
        try:
            self._camera = self._library.call("arv_camera_new", self._address.encode()) or 0
        except AravisError as error:
            raise self._named(error) from error
        if not self._camera:
            raise CameraLost(f"camera {self._address}: does not answer: check its power, its cable and its address")
        if not self._library.call("arv_camera_is_gv_device", self._camera):
            raise CameraConfigError(f"camera {self._address}: is not a GigE Vision camera")
        device = self._library.call("arv_camera_get_device", self._camera)
        if control and not self._library.call("arv_gv_device_is_controller", device):
            raise CameraBusy(
                f"camera {self._address}: another client controls it; close that one, or wait for it to go"
            )
        self._features = Features(self._library, device, self._address)

    def start(self) -> CameraInfo:
        """Apply the settings, start the stream and take one picture to see that all is well.  Raises CameraError."""
        try:
            apply_settings(self.features, self._settings, self._address)
            self._apply_packets()
            apply_features(self.features, self._settings)
            info = read_info(self.features, self._address)
            self._stream = AravisStream(
                self._library, self._camera, self._address, info, self._settings, self._statistics
            )
            self._taker = Taker(self._stream, self._statistics)
            self._stream.start()
            self._prime(self._stream, self._taker)
            self._statistics.socket_buffer_bytes = self._stream.socket_buffer_bytes()
        except AravisError as error:
            raise self._named(error) from error
        return info

    def snap(self, deadline_s: float) -> ImageFrame:
        """Trigger and return the frame; one bad frame is taken again while there is time.  Raises CameraError."""
        if self._stream is None or self._taker is None:
            raise CameraLost(f"camera {self._address}: is not open")
        try:
            return self._taker.snap(deadline_s)
        except AravisError as error:
            raise self._named(error) from error
        finally:
            self._stream.count()

    def payload_bytes(self) -> int:
        """Return how large a frame is.  Raises CameraError."""
        try:
            return int(self._library.call("arv_camera_get_payload", self._camera))
        except AravisError as error:
            raise self._named(error) from error

    def close(self) -> None:
        """Give the camera back.  Takes seconds if it does not answer; may be called twice."""
        try:
            if self._stream is not None:
                self._stream.close()
        except AravisError as error:
            raise self._named(error) from error
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Give up a camera that does not answer: as `close`, without asking it to stop."""
        camera, stream = self._camera, self._stream
        self._camera, self._features, self._stream, self._taker = 0, None, None, None
        if stream is not None:
            stream.drop()
        self._library.unref(camera)

    def _apply_packets(self) -> None:
        features, wanted = self.features, self._settings
        self._library.call("arv_camera_gv_set_packet_size_adjustment", self._camera, _NEVER_ADJUST)
        options = StreamOption.NONE if wanted.packet_socket else StreamOption.PACKET_SOCKET_DISABLED
        self._library.call("arv_camera_gv_set_stream_options", self._camera, options)
        if wanted.packet_size is None:
            self._library.call("arv_camera_gv_auto_packet_size", self._camera)
        else:
            features.set("GevSCPSPacketSize", wanted.packet_size)
        delay_ns = wanted.packet_delay_ns
        if delay_ns is None:
            delay_ns = 0 if kernel_buffer_limit() >= 1.5 * self.payload_bytes() else _AUTO_DELAY_NS
        if features.has("GevSCPD"):
            frequency = features.get("GevTimestampTickFrequency") if features.has("GevTimestampTickFrequency") else 0
            ticks_per_s = int(frequency) or 1_000_000_000
            features.set("GevSCPD", delay_ns * ticks_per_s // 1_000_000_000)

    def _prime(self, stream: AravisStream, taker: Taker[ImageFrame]) -> None:
        try:
            taker.prime(time.monotonic() + _PRIMING_S)
        except CameraIncomplete:
            if self._settings.packet_size is not None:
                raise
            # Leaders pass and full packets do not: the path carries only small ones.
            self._library.call("arv_camera_stop_acquisition", self._camera)
            stream.drop()
            self.features.set("GevSCPSPacketSize", _SMALL_PACKET)
            stream.start()
            taker.prime(time.monotonic() + _PRIMING_S)

    def _named(self, error: AravisError) -> CameraError:
        """Return a camera error for one of the library."""
        text = str(error)
        if error.code == DeviceFault.NOT_CONTROLLER or "access-denied" in text or "privilege" in text:
            return CameraBusy(f"camera {self._address}: another client controls it ({text})")
        if error.code in (DeviceFault.TIMEOUT, DeviceFault.NOT_CONNECTED, DeviceFault.NOT_FOUND):
            return CameraLost(f"camera {self._address}: no longer answers: check its power and its cable ({text})")
        return CameraConfigError(f"camera {self._address}: {text}")


def kernel_buffer_limit() -> int:
    """Return how large a socket's receive buffer may be (net.core.rmem_max), 0 if that cannot be known."""
    try:
        return int(_RMEM_MAX.read_text())
    except (OSError, ValueError):
        return 0
