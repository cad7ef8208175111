"""How do frames come through libaravis?  The running acquisition of one open camera: trigger, buffers, whole frames.

Everything here blocks, on the one thread that owns the camera.
"""

import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from slabcell_drivers.camera.aravis_library import AravisError, AravisLibrary, BufferStatus, DeviceFault, Pointer
from slabcell_drivers.camera.pixel_formats import PixelFormat, PixelFormatError, decode_pixels, format_of_code
from slabcell_drivers.camera.protocol import CameraIncomplete, CameraInfo, CameraLost, ImageFrame
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics

__all__ = ["AravisStream"]

_FIXED_BUFFER: Final = 0
_IMAGE: Final = 1
_UDP: Final = (socket.AF_INET, socket.SOCK_DGRAM)
_GONE: Final = (DeviceFault.TIMEOUT, DeviceFault.NOT_CONNECTED, DeviceFault.PROTOCOL_ERROR, DeviceFault.NOT_CONTROLLER)


class AravisStream:
    """The acquisition of a camera that is set to wait for triggers; a `taking.Source`.  ``name`` is its address."""

    def __init__(
        self,
        library: AravisLibrary,
        camera: Pointer,
        name: str,
        info: CameraInfo,
        settings: CameraSettings,
        statistics: CameraStatistics,
    ) -> None:
        self.name = name
        self._library = library
        self._camera = camera
        self._info = info
        self._settings = settings
        self._statistics = statistics
        self._stream: Pointer = 0
        self._counted = (0, 0, 0)

    def start(self) -> None:
        """Begin the acquisition on a stream of its own."""
        wanted = self._settings
        payload = self._library.call("arv_camera_get_payload", self._camera)
        self._stream = self._library.call("arv_camera_create_stream", self._camera, None, None) or 0
        if not self._stream:
            raise CameraLost(f"camera {self.name}: gives no stream")
        # FIXED: with AUTO, Aravis takes the size of a small picture for its buffer, and loses packets (aravis #865).
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
        self._library.call("arv_camera_start_acquisition", self._camera)

    def restart(self) -> None:
        """Begin the acquisition again on a new stream.

        The old stream would not do: its thread takes ids that begin at 1 again for late frames, and drops them.
        """
        self._library.call("arv_camera_stop_acquisition", self._camera)
        self.drop()
        self.start()

    def close(self) -> None:
        """End the acquisition; a camera that is gone or belongs to another has nothing to stop any more."""
        try:
            if self._stream:
                self._library.call("arv_camera_stop_acquisition", self._camera)
        except AravisError as error:
            if error.code not in _GONE:
                raise
        finally:
            self.drop()

    def drop(self) -> None:
        """Give up the stream without asking the camera anything."""
        self.count()
        stream, self._stream = self._stream, 0
        self._counted = (0, 0, 0)
        self._library.unref(stream)

    def leftovers(self) -> Iterator[int]:
        """Give back every frame that nobody waits for, and yield their ids."""
        while buffer := self._library.call("arv_stream_try_pop_buffer", self._stream):
            frame_id = int(self._library.call("arv_buffer_get_frame_id", buffer))
            self._library.call("arv_stream_push_buffer", self._stream, buffer)
            yield frame_id

    def trigger(self) -> None:
        """Send the software trigger."""
        self._library.call("arv_camera_software_trigger", self._camera)

    def wait(self, triggered_s: float, deadline_s: float, wanted: Callable[[int | None], bool]) -> ImageFrame | None:
        """Return the next whole frame whose id is wanted, None when the time is over.  Raises CameraIncomplete."""
        while (left_us := int((deadline_s - time.monotonic()) * 1e6)) > 0:
            buffer = self._library.call("arv_stream_timeout_pop_buffer", self._stream, left_us)
            if not buffer:
                continue
            try:
                frame_id = self._whole(buffer)
                if wanted(frame_id):
                    return self._decode(buffer, frame_id, triggered_s)
            finally:
                self._library.call("arv_stream_push_buffer", self._stream, buffer)
        return None

    def count(self) -> None:
        """Take over what the stream counted since it was last asked."""
        if not self._stream:
            return
        _, _, underruns, resent, missing = self._library.stream_statistics(self._stream)
        before, self._counted = self._counted, (underruns, resent, missing)
        self._statistics.underruns += max(0, underruns - before[0])
        self._statistics.packets_resent += max(0, resent - before[1])
        self._statistics.packets_missing += max(0, missing - before[2])

    def socket_buffer_bytes(self) -> int:
        """Return how large a buffer the kernel gave the stream's socket, 0 if it is none of UDP.

        The library sets it when the first packets come, and tells nobody what it got: the socket is asked itself.
        """
        port = self._library.call("arv_gv_stream_get_port", self._stream)
        for entry in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(OSError):  # the listing itself, closed by now
                if str(entry.readlink()).startswith("socket:"):
                    with socket.socket(fileno=os.dup(int(entry.name))) as found:
                        if (found.family, found.type) == _UDP and found.getsockname()[1] == port:
                            return found.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # told twice as large
        return 0

    def _whole(self, buffer: Pointer) -> int:
        """Return the id of the frame in a buffer.  Raises CameraIncomplete if packets of it are missing."""
        status = BufferStatus(self._library.call("arv_buffer_get_status", buffer))
        frame_id = int(self._library.call("arv_buffer_get_frame_id", buffer))
        if status is not BufferStatus.SUCCESS:
            raise CameraIncomplete(
                f"camera {self.name}: frame {frame_id} is not whole ({status.name.lower()}): packets were lost;"
                f" `slabcell camera stream-test {self.name}` says what to change"
            )
        return frame_id

    def _decode(self, buffer: Pointer, frame_id: int, triggered_s: float) -> ImageFrame:
        library, info = self._library, self._info
        width = library.call("arv_buffer_get_image_width", buffer)
        height = library.call("arv_buffer_get_image_height", buffer)
        code = library.call("arv_buffer_get_image_pixel_format", buffer)
        kind = library.call("arv_buffer_get_payload_type", buffer)
        data = library.data(buffer)
        if kind != _IMAGE or (width, height) != (info.width, info.height):
            raise CameraIncomplete(
                f"camera {self.name}: frame {frame_id} has {width}x{height} pixels, the camera is set to"
                f" {info.width}x{info.height}: did another client set it?"
            )
        try:
            form = format_of_code(code)
            pixels = decode_pixels(data, width, height, _expect(form, info))
        except PixelFormatError as error:
            raise CameraIncomplete(f"camera {self.name}: frame {frame_id} cannot be read: {error}") from error
        stamp = int(library.call("arv_buffer_get_timestamp", buffer))
        said = {
            "status": BufferStatus.SUCCESS.name.lower(),
            "bytes": data.size,
            "offset_x": int(library.call("arv_buffer_get_image_x", buffer)),
            "offset_y": int(library.call("arv_buffer_get_image_y", buffer)),
            "system_timestamp_ns": int(library.call("arv_buffer_get_system_timestamp", buffer)),
        }
        return ImageFrame(pixels, form.name, frame_id, triggered_s, time.monotonic(), stamp or None, said)


def _expect(form: PixelFormat, info: CameraInfo) -> PixelFormat:
    if form.name != info.pixel_format:
        raise PixelFormatError(f"it is {form.name}, the camera is set to {info.pixel_format}")
    return form
