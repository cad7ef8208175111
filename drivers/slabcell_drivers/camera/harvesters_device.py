"""How is a picture taken through Harvesters and a GenTL producer?  One open camera; blocking, in a process of its own.

Quirks of Harvesters 1.4 that this module works around, each where it is met: only `try_fetch` keeps to a time; `stop`
gives up half-way when the camera is gone; a row's padding is not removed; producers lack any attribute they like.
"""

import importlib
import time
from collections.abc import Sequence
from ipaddress import IPv4Address
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS, PixelFormatError, format_of_code
from slabcell_drivers.camera.protocol import (
    CameraBusy,
    CameraConfigError,
    CameraError,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    CameraTimeout,
)
from slabcell_drivers.camera.sequence import FrameSequence, Verdict
from slabcell_drivers.camera.settings import CameraSettings, FeatureValue

__all__ = ["HarvestersDevice", "RawFrame"]

# Neither package has type information, and both are optional: this is the one place where they are imported.
_core: Any = importlib.import_module("harvesters.core")
_gentl: Any = importlib.import_module("genicam.gentl")
_genapi: Any = importlib.import_module("genicam.genapi")

_FETCH_S: Final = 0.05
_POLL_MS: Final = 1
_PRIMING_S: Final = 2.0
_PRIMING_TRIES: Final = 3
_BUSY: Final = ("AccessDeniedException", "ResourceInUseException", "BusyException")
_LOST: Final = ("TimeoutException", "IoException", "InvalidHandleException", "InvalidIdException")

RawFrame = tuple[npt.NDArray[np.uint8], dict[str, Any]]
"""The bytes of a frame, and what the producer says of it."""


class HarvestersDevice:
    """A camera behind a GenTL producer.  ``camera`` is a serial number, device id or user-defined name.

    ``serial`` is a serial number that is as good, for a producer that does not know the camera by ``camera``.
    """

    def __init__(self, producers: Sequence[str], camera: str, serial: str, settings: CameraSettings) -> None:
        self._camera = camera
        self._serial = serial
        self._settings = settings
        self._incomplete = 0
        self._doubtful = False
        self._sequence = FrameSequence()
        self._info: CameraInfo | None = None
        self._acquirer: Any = None
        self._harvester: Any = _core.Harvester()
        for producer in producers:
            self._harvester.add_file(producer)
        self.counts = {"stale": 0, "gaps": 0, "incomplete": 0, "timeouts": 0, "retries": 0, "restarts": 0}

    def start(self) -> tuple[CameraInfo, str]:
        """Take control, apply the settings, take one picture; return who it is and its IP address, if it has one."""
        try:
            self._harvester.update()
            self._acquirer = self._harvester.create(self._choose(), config=self._config())
            self._acquirer.add_callback(_core.ImageAcquirer.Events.INCOMPLETE_BUFFER, _Count(self))
            self._acquirer.num_buffers = max(self._settings.buffers, self._acquirer.min_num_buffers)
            self._apply()
            self._info = self._read_info()
            self._acquirer.start()
            self._prime(time.monotonic() + _PRIMING_TRIES * _PRIMING_S)
        except (_gentl.GenericException, _genapi.GenericException) as error:
            raise self._named(error) from error
        return self._info, self._address()

    def snap(self, deadline_s: float) -> RawFrame:
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
                self.counts["retries"] += 1
                self._restart(deadline_s)
                return self._shoot(deadline_s)
        except (_gentl.GenericException, _genapi.GenericException) as error:
            self._doubtful = True
            raise self._named(error) from error

    def incomplete(self) -> None:
        """Count a frame that the producer gave up."""
        self._incomplete += 1

    def close(self) -> None:
        """Give the camera back.  Raises nothing that the producer raises: the process ends next."""
        if self._acquirer is not None:
            try:
                self._acquirer.stop()
                self._acquirer.destroy()
            except (_gentl.GenericException, _genapi.GenericException):
                # The camera has gone; `stop` leaves the streams running, and only they can still be stopped.
                self._kill_streams()
            self._acquirer = None
        self._harvester.reset()

    def _kill_streams(self) -> None:
        flags = _gentl.ACQ_STOP_FLAGS_LIST.ACQ_STOP_FLAGS_KILL
        for stream in self._acquirer._data_streams:
            try:
                stream.stop_acquisition(flags)
            except _gentl.GenericException:
                continue  # it was stopped already, or the producer has given it up

    # --- settings

    def _config(self) -> Any:
        # Chunks are not used, and some producers answer with errors when asked for them at every frame.
        return _core.ParameterSet({_core.ParameterKey.ENABLE_AUTO_CHUNK_DATA_UPDATE: False})

    def _choose(self) -> int:
        """Return the place of the wanted camera in the producer's list.  Raises CameraLost."""
        names = [
            [_ask(device, name) for name in ("serial_number", "id_", "user_defined_name")]
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

    def _apply(self) -> None:
        wanted = self._settings
        for name, value in (("GevHeartbeatTimeout", wanted.heartbeat_ms), ("AcquisitionMode", "Continuous"),
                            ("TriggerSelector", "FrameStart"), ("TriggerMode", "On"),
                            ("TriggerSource", "Software")):  # fmt: skip
            if self._has(name):
                self._set(name, value)
        if wanted.width or wanted.height:
            for name in ("OffsetX", "OffsetY"):
                if self._has(name):
                    self._set(name, 0)
        for name, value in (("PixelFormat", wanted.pixel_format), ("Width", wanted.width), ("Height", wanted.height),
                            ("OffsetX", wanted.offset_x), ("OffsetY", wanted.offset_y),
                            ("ExposureTime", wanted.exposure_us), ("Gain", wanted.gain_db),
                            ("GevSCPSPacketSize", wanted.packet_size),
                            ("GevSCPD", wanted.packet_delay_ns)):  # fmt: skip
            if value is not None:
                self._set(name, value)
        for name, value in wanted.features.items():
            self._set(name, value)

    def _has(self, name: str) -> bool:
        return bool(self._nodes.has_node(name))

    @property
    def _nodes(self) -> Any:
        return self._acquirer.remote_device.node_map

    def _set(self, name: str, value: FeatureValue) -> None:
        """Set a feature and read it back.  Raises CameraConfigError."""
        if not self._has(name):
            raise CameraConfigError(f"camera {self._camera}: has no feature {name}")
        node = getattr(self._nodes, name)
        kind = type(node).__name__
        if kind == "ICommand":
            node.execute()
            return
        low, high = _ask(node, "min"), _ask(node, "max")
        if kind in ("IInteger", "IFloat") and low is not None and not low <= float(value) <= high:
            raise CameraConfigError(
                f"camera {self._camera}: {name} = {value} is refused: it must be {low:.10g} to {high:.10g}"
            )
        if kind == "IEnumeration" and value not in node.symbolics:
            raise CameraConfigError(
                f"camera {self._camera}: {name} = {value} is refused: it takes {', '.join(node.symbolics)}"
            )
        try:
            node.value = value
            seen = node.value
        except (_genapi.GenericException, TypeError) as error:
            if type(error).__name__ in _LOST:
                raise
            raise CameraConfigError(f"camera {self._camera}: {name} = {value} is refused: {error}") from error
        same = bool(seen == value)
        if kind == "IFloat":
            same = abs(float(seen) - float(value)) <= max(0.005 * abs(float(value)), 0.011)
        if not same:
            raise CameraConfigError(f"camera {self._camera}: {name} was set to {value} and reads {seen}")

    def _read_info(self) -> CameraInfo:
        nodes = self._nodes
        form = str(nodes.PixelFormat.value)
        if form not in PIXEL_FORMATS:
            raise CameraConfigError(
                f"camera {self._camera}: PixelFormat = {form} cannot be decoded; set one of {', '.join(PIXEL_FORMATS)}"
            )
        vendor, model, serial = (
            str(getattr(nodes, name).value) if self._has(name) else ""
            for name in ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber")
        )
        return CameraInfo(vendor, model, serial, int(nodes.Width.value), int(nodes.Height.value), form)

    def _address(self) -> str:
        """Return the camera's IPv4 address, empty if it has none that it tells."""
        if not self._has("GevCurrentIPAddress"):
            return ""
        number = int(self._nodes.GevCurrentIPAddress.value)
        return ".".join(str(byte) for byte in number.to_bytes(4, "big"))

    # --- pictures

    def _prime(self, deadline_s: float) -> None:
        """Take pictures until one is whole: after every start the first is often incomplete.  Raises CameraError."""
        self._sequence = FrameSequence()
        for attempt in range(_PRIMING_TRIES):
            try:
                self._shoot(min(time.monotonic() + _PRIMING_S, deadline_s))
            except CameraIncomplete:
                self._sequence = FrameSequence()
                if attempt == _PRIMING_TRIES - 1:
                    raise
            else:
                return

    def _restart(self, deadline_s: float) -> None:
        """Begin the acquisition again, so that no old frame can be taken for a new one."""
        self.counts["restarts"] += 1
        self._acquirer.stop()
        self._acquirer.start()
        self._prime(deadline_s)

    def _shoot(self, deadline_s: float) -> RawFrame:
        self._doubtful = True
        self._flush()
        self._incomplete = 0
        self._nodes.TriggerSoftware.execute()
        while (left_s := deadline_s - time.monotonic()) > 0:
            raw = self._acquirer.try_fetch(timeout=min(_FETCH_S, left_s), is_raw=True)
            if raw is None:
                if self._incomplete:
                    self.counts["incomplete"] += 1
                    raise CameraIncomplete(f"camera {self._camera}: a frame is not whole: packets were lost")
                continue
            try:
                frame = self._verify(raw)
            finally:
                raw.parent.queue_buffer(raw)
            if frame is not None:
                self._doubtful = False
                return frame
        self.counts["timeouts"] += 1
        raise CameraTimeout(
            f"camera {self._camera}: no frame in time after the trigger; check exposure time, trigger source and"
            " network"
        )

    def _flush(self) -> None:
        """Return every frame that nobody waits for."""
        self._acquirer.timeout_period_on_update_event_data_call = 0
        try:
            while (raw := self._acquirer.try_fetch(timeout=5e-5, is_raw=True)) is not None:
                self.counts["stale"] += 1
                if (frame_id := _ask(raw, "frame_id")) is not None:
                    self._sequence.judge(frame_id)  # it is counted, so that the next one is known
                raw.parent.queue_buffer(raw)
        finally:
            self._acquirer.timeout_period_on_update_event_data_call = _POLL_MS

    def _verify(self, raw: Any) -> RawFrame | None:
        """Return a copy of the frame, None if it belongs to an earlier trigger.  Raises CameraIncomplete."""
        frame_id = _ask(raw, "frame_id")
        if frame_id is not None:
            missed = self._sequence.missed(frame_id)
            verdict = self._sequence.judge(frame_id)
            if verdict is Verdict.STALE:
                self.counts["stale"] += 1
                return None
            if verdict is Verdict.BROKEN:
                self.counts["gaps"] += max(1, missed)
                raise CameraIncomplete(
                    f"camera {self._camera}: frame {frame_id} came, {self._sequence.expected} was next: the count is"
                    " broken, so the frame cannot be told to be new"
                )
        info = self._info
        if info is None:
            raise CameraLost(f"camera {self._camera}: is not open")
        form = PIXEL_FORMATS[info.pixel_format]
        code = _ask(raw, "pixel_format")
        if code:
            try:
                form = format_of_code(int(code))
            except PixelFormatError as error:
                raise CameraIncomplete(f"camera {self._camera}: frame {frame_id} cannot be read: {error}") from error
        width, height = _ask(raw, "width") or info.width, _ask(raw, "height") or info.height
        need = form.frame_bytes(info.width, info.height)
        filled = _ask(raw, "size_filled")
        if (width, height, form.name) != (info.width, info.height, info.pixel_format) or (filled or need) < need:
            self.counts["incomplete"] += 1
            raise CameraIncomplete(
                f"camera {self._camera}: frame {frame_id} is {form.name} of {width}x{height} pixels in {filled} bytes;"
                f" the camera is set to {info.pixel_format} of {info.width}x{info.height}"
            )
        stamp = _ask(raw, "timestamp_ns") or _ask(raw, "timestamp")
        document = {"frame_id": int(frame_id or 0), "bytes": need, "device_timestamp_ns": stamp or None}
        return np.frombuffer(raw.raw_buffer, np.uint8, count=need).copy(), document

    def _named(self, error: Exception) -> CameraError:
        name = type(error).__name__
        if name in _BUSY or "privilege" in str(error):
            return CameraBusy(f"camera {self._camera}: another client controls it ({error})")
        if name in _LOST or "imeout" in str(error):
            return CameraLost(f"camera {self._camera}: no longer answers: check its power and its cable ({error})")
        return CameraConfigError(f"camera {self._camera}: {name}: {error}")


class _Count(_core.Callback):
    """Is called by Harvesters when it throws an incomplete frame away."""

    def __init__(self, device: HarvestersDevice) -> None:
        self._device = device

    def emit(self, context: Any) -> None:
        del context
        self._device.incomplete()


def _is_address(text: object) -> bool:
    try:
        IPv4Address(str(text))
    except ValueError:
        return False
    return True


def _ask(thing: Any, name: str) -> Any:
    """Return an attribute that a producer may not have, None if it has not."""
    try:
        return getattr(thing, name)
    except (_gentl.GenericException, _genapi.GenericException, AttributeError):
        return None
