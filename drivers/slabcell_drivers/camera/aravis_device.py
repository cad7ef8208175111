"""How is a picture taken through libaravis?  One open camera: settings, stream, trigger, verified frame; all blocking.

Everything here runs on the one thread that owns the camera; `aravis` puts asyncio in front of it.
"""

import time
from pathlib import Path
from typing import Final

from slabcell_drivers.camera.aravis_features import Features
from slabcell_drivers.camera.aravis_library import (
    AravisError,
    AravisLibrary,
    BufferStatus,
    DeviceFault,
    Pointer,
    StreamOption,
)
from slabcell_drivers.camera.pixel_formats import (
    PIXEL_FORMATS,
    PixelFormat,
    PixelFormatError,
    decode_pixels,
    format_of_code,
)
from slabcell_drivers.camera.protocol import (
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    CameraTimeout,
    ImageFrame,
)
from slabcell_drivers.camera.sequence import FrameSequence, Verdict
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics

__all__ = ["AravisDevice", "kernel_buffer_limit"]

_NEVER_ADJUST: Final = 0
_FIXED_BUFFER: Final = 0
_IMAGE: Final = 1
_PRIMING_S: Final = 2.0
_PRIMING_TRIES: Final = 3
_SMALL_PACKET: Final = 1500
_AUTO_DELAY_NS: Final = 50_000
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
        self._stream: Pointer = 0
        self._sequence = FrameSequence()
        self._features: Features | None = None
        self._info: CameraInfo | None = None
        self._counted = (0, 0, 0)
        self._doubtful = False

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
            self._apply()
            self._info = self._read_info()
            self._open_stream()
            self._library.call("arv_camera_start_acquisition", self._camera)
            self._prime(time.monotonic() + _PRIMING_TRIES * _PRIMING_S)
        except AravisError as error:
            raise self._named(error) from error
        return self._info

    def snap(self, deadline_s: float) -> ImageFrame:
        """Trigger and return the frame; one bad frame is tried again while there is time.  Raises CameraError."""
        try:
            if self._doubtful:
                self._restart(deadline_s)
            first_s = time.monotonic() + max(0.5 * (deadline_s - time.monotonic()), 0.05)
            try:
                return self._shoot(min(first_s, deadline_s))
            except (CameraIncomplete, CameraTimeout):
                if time.monotonic() >= deadline_s - 0.02:
                    raise
                self._statistics.retries += 1
                self._restart(deadline_s)
                return self._shoot(deadline_s)
        except AravisError as error:
            self._doubtful = True
            raise self._named(error) from error
        finally:
            self._count()

    def close(self) -> None:
        """Give the camera back.  Takes seconds if it does not answer; may be called twice."""
        camera, stream = self._camera, self._stream
        self._camera = self._stream = 0
        self._features = None
        if stream:
            try:
                self._library.call("arv_camera_stop_acquisition", camera)
            except AravisError as error:
                if error.code not in (DeviceFault.TIMEOUT, DeviceFault.NOT_CONNECTED, DeviceFault.PROTOCOL_ERROR):
                    raise
                # It is gone or belongs to another: there is nothing to stop any more.
            finally:
                self._library.unref(stream)
                self._library.unref(camera)
        else:
            self._library.unref(camera)

    def abandon(self) -> None:
        """Give up a camera that does not answer: as `close`, without asking it to stop."""
        camera, stream = self._camera, self._stream
        self._camera = self._stream = 0
        self._features = None
        self._library.unref(stream)
        self._library.unref(camera)

    # --- settings

    def _apply(self) -> None:
        features, wanted = self.features, self._settings
        if features.has("GevHeartbeatTimeout"):
            features.set("GevHeartbeatTimeout", wanted.heartbeat_ms)
        for name, value in (("AcquisitionMode", "Continuous"), ("TriggerSelector", "FrameStart"),
                            ("TriggerMode", "On"), ("TriggerSource", "Software")):  # fmt: skip
            if features.has(name):
                features.set(name, value)
        # A smaller picture first, so that no offset is out of range on the way.
        for name in ("OffsetX", "OffsetY"):
            if features.has(name) and (wanted.width or wanted.height):
                features.set(name, 0)
        for name, value in (("PixelFormat", wanted.pixel_format), ("Width", wanted.width), ("Height", wanted.height),
                            ("OffsetX", wanted.offset_x), ("OffsetY", wanted.offset_y)):  # fmt: skip
            if value is not None:
                features.set(name, value)
        for names, number in ((("ExposureTime", "ExposureTimeAbs"), wanted.exposure_us),
                              (("Gain", "GainRaw"), wanted.gain_db)):  # fmt: skip
            if number is not None:
                name = features.first_of(*names)
                if name is None:
                    raise CameraConfigError(f"camera {self._address}: has none of {' and '.join(names)}")
                features.set(name, number)
        for name, value in wanted.features.items():
            features.set(name, value)
        self._apply_packets()

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
            payload = self._library.call("arv_camera_get_payload", self._camera)
            delay_ns = 0 if kernel_buffer_limit() >= 1.5 * payload else _AUTO_DELAY_NS
        if features.has("GevSCPD"):
            frequency = features.get("GevTimestampTickFrequency") if features.has("GevTimestampTickFrequency") else 0
            ticks_per_s = int(frequency) or 1_000_000_000
            features.set("GevSCPD", delay_ns * ticks_per_s // 1_000_000_000)

    def _read_info(self) -> CameraInfo:
        features = self.features
        serial = features.first_of("DeviceSerialNumber", "DeviceID")
        pixel_format = str(features.get("PixelFormat"))
        if pixel_format not in PIXEL_FORMATS:
            raise CameraConfigError(
                f"camera {self._address}: PixelFormat = {pixel_format} cannot be decoded; set one of"
                f" {', '.join(PIXEL_FORMATS)}"
            )
        return CameraInfo(
            str(features.get("DeviceVendorName")),
            str(features.get("DeviceModelName")),
            str(features.get(serial)) if serial else "",
            int(features.get("Width")),
            int(features.get("Height")),
            pixel_format,
        )

    # --- stream

    def _open_stream(self) -> None:
        wanted = self._settings
        payload = self._library.call("arv_camera_get_payload", self._camera)
        self._stream = self._library.call("arv_camera_create_stream", self._camera, None, None) or 0
        if not self._stream:
            raise CameraLost(f"camera {self._address}: gives no stream")
        self._library.set_properties(
            self._stream,
            socket_buffer=_FIXED_BUFFER,
            socket_buffer_size=wanted.socket_buffer_bytes,
            packet_resend=1 if wanted.resend else 0,
            packet_timeout=wanted.packet_timeout_us,
            frame_retention=wanted.frame_retention_us,
        )
        for _ in range(wanted.buffers):
            buffer = self._library.call("arv_buffer_new_allocate", payload)
            self._library.call("arv_stream_push_buffer", self._stream, buffer)  # the stream owns it from here on

    def _drop_stream(self) -> None:
        self._count()
        stream, self._stream = self._stream, 0
        self._counted = (0, 0, 0)
        self._library.unref(stream)

    def _prime(self, deadline_s: float) -> None:
        """Take pictures until one is whole: after every start the first is often incomplete.  Raises CameraError."""
        self._sequence = FrameSequence()
        for attempt in range(_PRIMING_TRIES):
            try:
                self._shoot(min(time.monotonic() + _PRIMING_S, deadline_s), count=False)
            except CameraIncomplete:
                # Leaders pass and full packets do not: the path carries only small ones.
                if attempt == _PRIMING_TRIES - 2 and self._settings.packet_size is None:
                    self._library.call("arv_camera_stop_acquisition", self._camera)
                    self._drop_stream()
                    self.features.set("GevSCPSPacketSize", _SMALL_PACKET)
                    self._open_stream()
                    self._library.call("arv_camera_start_acquisition", self._camera)
                self._sequence = FrameSequence()
                if attempt == _PRIMING_TRIES - 1:
                    raise
            else:
                self._doubtful = False
                return

    def _restart(self, deadline_s: float) -> None:
        """Begin the acquisition again on a stream of its own, so that no old frame can be taken for a new one.

        The old stream would not do: its thread takes ids that begin at 1 again for late frames, and drops them.
        """
        self._statistics.restarts += 1
        self._library.call("arv_camera_stop_acquisition", self._camera)
        self._drop_stream()
        self._open_stream()
        self._library.call("arv_camera_start_acquisition", self._camera)
        self._prime(deadline_s)

    def _flush(self) -> None:
        """Return every frame that nobody waits for to the stream."""
        while buffer := self._library.call("arv_stream_try_pop_buffer", self._stream):
            self._statistics.stale += 1
            self._sequence.judge(int(self._library.call("arv_buffer_get_frame_id", buffer)))  # the next one is known
            self._library.call("arv_stream_push_buffer", self._stream, buffer)

    def _shoot(self, deadline_s: float, *, count: bool = True) -> ImageFrame:
        self._doubtful = True  # until a frame has come, any frame that comes may be an old one
        self._flush()
        triggered_s = time.monotonic()
        self._library.call("arv_camera_software_trigger", self._camera)
        while True:
            left_us = int((deadline_s - time.monotonic()) * 1e6)
            buffer = self._library.call("arv_stream_timeout_pop_buffer", self._stream, left_us) if left_us > 0 else 0
            if not buffer:
                self._statistics.timeouts += 1
                raise CameraTimeout(
                    f"camera {self._address}: no frame within {time.monotonic() - triggered_s:.2f} s of the trigger;"
                    " check exposure time, trigger source and network"
                )
            try:
                frame = self._verify(buffer, triggered_s)
            finally:
                self._library.call("arv_stream_push_buffer", self._stream, buffer)
            if frame is not None:
                self._doubtful = False
                if count:
                    self._statistics.frames += 1
                    self._statistics.latency_s = frame.received_s - triggered_s
                return frame

    def _verify(self, buffer: Pointer, triggered_s: float) -> ImageFrame | None:
        """Return the frame in a buffer, None if it belongs to an earlier trigger.  Raises CameraIncomplete."""
        library = self._library
        status = BufferStatus(library.call("arv_buffer_get_status", buffer))
        frame_id = int(library.call("arv_buffer_get_frame_id", buffer))
        if status is not BufferStatus.SUCCESS:
            self._statistics.incomplete += 1
            raise CameraIncomplete(
                f"camera {self._address}: frame {frame_id} is not whole ({status.name.lower()}): packets were lost;"
                f" `slabcell camera stream-test {self._address}` says what to change"
            )
        missed = self._sequence.missed(frame_id)
        match self._sequence.judge(frame_id):
            case Verdict.STALE:
                self._statistics.stale += 1
                return None
            case Verdict.BROKEN:
                self._statistics.gaps += max(1, missed)
                raise CameraIncomplete(
                    f"camera {self._address}: frame {frame_id} came, {self._sequence.expected} was next: the count is"
                    " broken, so the frame cannot be told to be new"
                )
            case Verdict.OWN:
                pass
        return self._decode(buffer, frame_id, triggered_s)

    def _decode(self, buffer: Pointer, frame_id: int, triggered_s: float) -> ImageFrame:
        library, info = self._library, self._info
        width = library.call("arv_buffer_get_image_width", buffer)
        height = library.call("arv_buffer_get_image_height", buffer)
        code = library.call("arv_buffer_get_image_pixel_format", buffer)
        kind = library.call("arv_buffer_get_payload_type", buffer)
        data = library.data(buffer)
        if info is None or kind != _IMAGE or (width, height) != (info.width, info.height):
            self._statistics.incomplete += 1
            wanted = f"{info.width}x{info.height}" if info else "no"
            raise CameraIncomplete(
                f"camera {self._address}: frame {frame_id} has {width}x{height} pixels, the camera is set to {wanted}"
            )
        try:
            form = format_of_code(code)
            pixels = decode_pixels(data, width, height, _expect(form, info))
        except PixelFormatError as error:
            self._statistics.incomplete += 1
            raise CameraIncomplete(f"camera {self._address}: frame {frame_id} cannot be read: {error}") from error
        stamp = int(library.call("arv_buffer_get_timestamp", buffer))
        return ImageFrame(pixels, form.name, frame_id, triggered_s, time.monotonic(), stamp or None)

    def _count(self) -> None:
        """Take over what the stream counted since it was last asked."""
        if not self._stream:
            return
        _, _, underruns, resent, missing = self._library.stream_statistics(self._stream)
        before, self._counted = self._counted, (underruns, resent, missing)
        self._statistics.underruns += max(0, underruns - before[0])
        self._statistics.packets_resent += max(0, resent - before[1])
        self._statistics.packets_missing += max(0, missing - before[2])

    def _named(self, error: AravisError) -> CameraError:
        """Return a camera error for one of the library."""
        text = str(error)
        if error.code == DeviceFault.NOT_CONTROLLER or "access-denied" in text or "privilege" in text:
            return CameraBusy(f"camera {self._address}: another client controls it ({text})")
        if error.code in (DeviceFault.TIMEOUT, DeviceFault.NOT_CONNECTED, DeviceFault.NOT_FOUND):
            return CameraLost(f"camera {self._address}: no longer answers: check its power and its cable ({text})")
        return CameraConfigError(f"camera {self._address}: {text}")


def _expect(form: PixelFormat, info: CameraInfo) -> PixelFormat:
    if form.name != info.pixel_format:
        raise PixelFormatError(f"it is {form.name}, the camera is set to {info.pixel_format}")
    return form


def kernel_buffer_limit() -> int:
    """Return how large a socket's receive buffer may be (net.core.rmem_max), 0 if that cannot be known."""
    try:
        return int(_RMEM_MAX.read_text())
    except (OSError, ValueError):
        return 0
