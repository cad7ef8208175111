"""How do frames come through Harvesters?  The running acquisition of one open camera: trigger, buffers, whole frames.

Quirks of Harvesters 1.4 that this module works around, each where it is met: only `try_fetch` keeps to a time; a row's
padding is not removed; producers lack any attribute they like.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.genicam_binding import ask, core
from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS, PixelFormat, PixelFormatError, format_of_code
from slabcell_drivers.camera.protocol import CameraIncomplete, CameraInfo
from slabcell_drivers.camera.settings import CameraStatistics

__all__ = ["HarvestersStream", "RawFrame"]

_FETCH_S: Final = 0.05
_POLL_MS: Final = 1
_TOLD: Final = ("timestamp_frequency", "size_filled", "delivered_image_height", "offset_x", "offset_y", "payload_type")
"""What else producers say of a frame, by the names that the binding gives it."""


@dataclass(frozen=True, slots=True)
class RawFrame:
    """A whole frame; its bytes lie in the memory that the stream was given, until the next one."""

    size: int
    frame_id: int
    triggered_s: float
    device_timestamp_ns: int | None
    said: dict[str, int]


class HarvestersStream:
    """The acquisition of a camera that is set to wait for triggers; a `taking.Source`.

    ``memory`` is where the bytes of a frame are put.
    """

    def __init__(
        self, acquirer: Any, name: str, info: CameraInfo, memory: npt.NDArray[np.uint8], statistics: CameraStatistics
    ) -> None:
        self.name = name
        self._acquirer = acquirer
        self._nodes = acquirer.remote_device.node_map
        self._info = info
        self._memory = memory
        self._statistics = statistics
        self._thrown_away = 0
        self._underruns = 0
        acquirer.add_callback(core.ImageAcquirer.Events.INCOMPLETE_BUFFER, _Notice(self._notice))

    def start(self) -> None:
        """Begin the acquisition."""
        self._underruns = 0
        self._acquirer.start()

    def restart(self) -> None:
        """Begin the acquisition again: the producer gives back every buffer, filled or not."""
        self.count()
        self._acquirer.stop()
        self.start()

    def leftovers(self) -> Iterator[int | None]:
        """Give back every frame that nobody waits for, and yield their ids."""
        self._acquirer.timeout_period_on_update_event_data_call = 0
        try:
            while (raw := self._acquirer.try_fetch(timeout=5e-5, is_raw=True)) is not None:
                frame_id = ask(raw, "frame_id")
                raw.parent.queue_buffer(raw)
                yield frame_id
        finally:
            self._acquirer.timeout_period_on_update_event_data_call = _POLL_MS

    def trigger(self) -> None:
        """Send the software trigger."""
        self._thrown_away = 0
        self._nodes.TriggerSoftware.execute()

    def wait(self, triggered_s: float, deadline_s: float, wanted: Callable[[int | None], bool]) -> RawFrame | None:
        """Return the next whole frame whose id is wanted, None when the time is over.  Raises CameraIncomplete."""
        while (left_s := deadline_s - time.monotonic()) > 0:
            raw = self._acquirer.try_fetch(timeout=min(_FETCH_S, left_s), is_raw=True)
            if raw is None:
                if self._thrown_away:
                    raise CameraIncomplete(
                        f"camera {self.name}: a frame is not whole: packets were lost; look at cable, switch, packet"
                        " size and net.core.rmem_max (for GigE Vision `slabcell camera stream-test` measures them)"
                    )
                continue
            try:
                frame_id = ask(raw, "frame_id")
                if wanted(frame_id):
                    return self._copied(raw, frame_id, triggered_s)
            finally:
                raw.parent.queue_buffer(raw)
        return None

    def count(self) -> None:
        """Take over what the producer counted since it was last asked."""
        underruns = sum(int(ask(stream, "num_underrun") or 0) for stream in self._acquirer.data_streams)
        self._statistics.underruns += max(0, underruns - self._underruns)
        self._underruns = underruns

    def _notice(self) -> None:
        self._thrown_away += 1

    def _copied(self, raw: Any, frame_id: int | None, triggered_s: float) -> RawFrame:
        """Copy a frame before its buffer is queued again.  Raises CameraIncomplete if it is not as it was set."""
        info = self._info
        form = self._format(raw, frame_id)
        width, height = ask(raw, "width") or info.width, ask(raw, "height") or info.height
        need = form.frame_bytes(info.width, info.height)
        filled = ask(raw, "size_filled")
        if (width, height, form.name) != (info.width, info.height, info.pixel_format) or (filled or need) < need:
            raise CameraIncomplete(
                f"camera {self.name}: frame {frame_id} is {form.name} of {width}x{height} pixels in {filled} bytes;"
                f" the camera is set to {info.pixel_format} of {info.width}x{info.height}"
            )
        self._memory[:need] = np.frombuffer(raw.raw_buffer, np.uint8, count=need)
        stamp = ask(raw, "timestamp_ns") or ask(raw, "timestamp")
        said = {name: int(value) for name in _TOLD if (value := ask(raw, name)) is not None}
        return RawFrame(need, int(frame_id or 0), triggered_s, stamp or None, said)

    def _format(self, raw: Any, frame_id: int | None) -> PixelFormat:
        code = ask(raw, "pixel_format")
        if not code:
            return PIXEL_FORMATS[self._info.pixel_format]  # a producer that does not say
        try:
            return format_of_code(int(code))
        except PixelFormatError as error:
            raise CameraIncomplete(f"camera {self.name}: frame {frame_id} cannot be read: {error}") from error


class _Notice(core.Callback):
    """Is called by Harvesters when it throws an incomplete frame away."""

    def __init__(self, notice: Callable[[], None]) -> None:
        self._notice = notice

    def emit(self, context: Any) -> None:
        del context
        self._notice()
