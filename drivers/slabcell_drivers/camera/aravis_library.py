"""How is libaravis called?  The one place with ctypes: every function of libaravis-0.8 that we use, with its types.

No vendor SDK, no build, no PyGObject: the system package ``libaravis-0.8-0`` is enough.  ctypes gives up Python's
global lock during each call, so that a camera that does not answer (2.5 s a call) stops only its own thread.

Source: Aravis 0.8 headers and reference manual, https://aravisproject.github.io/aravis/aravis-stable/
"""

import ctypes
from collections.abc import Callable, Iterator
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint16, c_uint64, c_void_p
from enum import IntEnum
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt

__all__ = [
    "AravisError",
    "AravisLibrary",
    "AravisMissingError",
    "BufferStatus",
    "DeviceFault",
    "Pointer",
    "StreamOption",
]

LIBRARY: Final = "libaravis-0.8.so.0"
REMEDY: Final = "install the system package libaravis-0.8-0 (apt-get install --no-install-recommends libaravis-0.8-0)"

Pointer = int
"""Address of an object of the library; 0 is none."""


class DeviceFault(IntEnum):
    """Codes of the library's device errors."""

    WRONG_FEATURE = 0
    FEATURE_NOT_FOUND = 1
    NOT_CONNECTED = 2
    PROTOCOL_ERROR = 3
    TRANSFER_ERROR = 4
    TIMEOUT = 5
    NOT_FOUND = 6
    INVALID_PARAMETER = 7
    GENICAM_NOT_FOUND = 8
    NO_STREAM_CHANNEL = 9
    NOT_CONTROLLER = 10
    UNKNOWN = 11


class BufferStatus(IntEnum):
    """What became of a frame."""

    UNKNOWN = -1
    SUCCESS = 0
    CLEARED = 1
    TIMEOUT = 2
    MISSING_PACKETS = 3
    WRONG_PACKET_ID = 4
    SIZE_MISMATCH = 5
    FILLING = 6
    ABORTED = 7


class StreamOption(IntEnum):
    """How packets are received."""

    NONE = 0
    PACKET_SOCKET_DISABLED = 1


class AravisMissingError(Exception):
    """The library is not on this machine; the message says how to get it."""


class AravisError(Exception):
    """A call failed.  ``code`` is a `DeviceFault` where the library says so."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


class _GSList(ctypes.Structure):
    pass


_GSList._fields_ = (("data", c_char_p), ("next", POINTER(_GSList)))

_ERROR = POINTER(POINTER(_GError))

# Name -> (type of the result, types of the arguments); a trailing _ERROR is filled in by `AravisLibrary.call`.
_PROTOTYPES: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "arv_camera_new": (c_void_p, (c_char_p, _ERROR)),
    "arv_camera_get_device": (c_void_p, (c_void_p,)),
    "arv_camera_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p, _ERROR)),
    "arv_camera_start_acquisition": (None, (c_void_p, _ERROR)),
    "arv_camera_stop_acquisition": (None, (c_void_p, _ERROR)),
    "arv_camera_software_trigger": (None, (c_void_p, _ERROR)),
    "arv_camera_get_payload": (c_uint, (c_void_p, _ERROR)),
    "arv_camera_gv_set_stream_options": (None, (c_void_p, c_int)),
    "arv_camera_gv_set_packet_size_adjustment": (None, (c_void_p, c_int)),
    "arv_camera_gv_auto_packet_size": (c_uint, (c_void_p, _ERROR)),
    "arv_camera_is_gv_device": (c_int, (c_void_p,)),
    "arv_gv_device_is_controller": (c_int, (c_void_p,)),
    "arv_device_get_feature": (c_void_p, (c_void_p, c_char_p)),
    "arv_device_is_feature_available": (c_int, (c_void_p, c_char_p, _ERROR)),
    "arv_device_execute_command": (None, (c_void_p, c_char_p, _ERROR)),
    "arv_device_get_integer_feature_value": (c_int64, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_integer_feature_value": (None, (c_void_p, c_char_p, c_int64, _ERROR)),
    "arv_device_get_integer_feature_bounds": (None, (c_void_p, c_char_p, POINTER(c_int64), POINTER(c_int64), _ERROR)),
    "arv_device_get_integer_feature_increment": (c_int64, (c_void_p, c_char_p, _ERROR)),
    "arv_device_get_float_feature_value": (c_double, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_float_feature_value": (None, (c_void_p, c_char_p, c_double, _ERROR)),
    "arv_device_get_float_feature_bounds": (None, (c_void_p, c_char_p, POINTER(c_double), POINTER(c_double), _ERROR)),
    "arv_device_get_boolean_feature_value": (c_int, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_boolean_feature_value": (None, (c_void_p, c_char_p, c_int, _ERROR)),
    "arv_device_get_string_feature_value": (c_char_p, (c_void_p, c_char_p, _ERROR)),
    "arv_device_set_string_feature_value": (None, (c_void_p, c_char_p, c_char_p, _ERROR)),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(c_char_p),
        (c_void_p, c_char_p, POINTER(c_uint), _ERROR),
    ),
    "arv_gc_category_get_features": (POINTER(_GSList), (c_void_p,)),
    "arv_gc_feature_node_get_actual_access_mode": (c_int, (c_void_p,)),
    "arv_buffer_new_allocate": (c_void_p, (c_size_t,)),
    "arv_buffer_get_status": (c_int, (c_void_p,)),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_system_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_image_x": (c_int, (c_void_p,)),
    "arv_buffer_get_image_y": (c_int, (c_void_p,)),
    "arv_buffer_get_image_width": (c_int, (c_void_p,)),
    "arv_buffer_get_image_height": (c_int, (c_void_p,)),
    "arv_buffer_get_image_pixel_format": (c_uint, (c_void_p,)),
    "arv_buffer_get_payload_type": (c_int, (c_void_p,)),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p)),
    "arv_stream_try_pop_buffer": (c_void_p, (c_void_p,)),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64)),
    "arv_stream_get_statistics": (None, (c_void_p, POINTER(c_uint64), POINTER(c_uint64), POINTER(c_uint64))),
    "arv_gv_stream_get_port": (c_uint16, (c_void_p,)),
    "arv_gv_stream_get_statistics": (None, (c_void_p, POINTER(c_uint64), POINTER(c_uint64))),
    "g_object_unref": (None, (c_void_p,)),
    "g_error_free": (None, (c_void_p,)),
    "g_free": (None, (c_void_p,)),
    "g_type_name_from_instance": (c_char_p, (c_void_p,)),
}


class AravisLibrary:
    """The loaded library.  Objects of the library belong to one thread at a time; the caller sees to that."""

    def __init__(self) -> None:
        try:
            library = ctypes.CDLL(LIBRARY)
        except OSError as error:
            raise AravisMissingError(f"{LIBRARY} cannot be loaded ({error}); {REMEDY}") from error
        self._functions: dict[str, Callable[..., Any]] = {}
        self._fallible: set[str] = set()
        for name, (result, arguments) in _PROTOTYPES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
            self._functions[name] = function
            if arguments and arguments[-1] is _ERROR:
                self._fallible.add(name)
        self._set = library.g_object_set  # variadic: its types are given at each call
        self._set.restype = None

    def call(self, name: str, *arguments: object) -> Any:
        """Call a function of the library.  Raises AravisError if it reports an error."""
        if name not in self._fallible:
            return self._functions[name](*arguments)
        failure = POINTER(_GError)()
        result = self._functions[name](*arguments, byref(failure))
        if failure:
            content = failure.contents
            message = cast("bytes | None", content.message) or b"no reason given"
            error = AravisError(message.decode("utf-8", "replace"), int(content.code))
            self._functions["g_error_free"](failure)
            raise error
        return result

    def set_properties(self, target: Pointer, **properties: int) -> None:
        """Set integer or enumeration properties of an object; underscores stand for dashes."""
        for name, value in properties.items():
            self._set(c_void_p(target), c_char_p(name.replace("_", "-").encode()), c_int(value), c_void_p(None))

    def unref(self, target: Pointer) -> None:
        """Give an object back; 0 is nothing to give back."""
        if target:
            self.call("g_object_unref", target)

    def text(self, name: str, *arguments: object) -> str:
        """Call a function that returns text."""
        found = self.call(name, *arguments)
        return found.decode("utf-8", "replace") if found else ""

    def integer_bounds(self, device: Pointer, feature: bytes) -> tuple[int, int]:
        """Return the least and the greatest value of an integer feature."""
        low, high = c_int64(), c_int64()
        self.call("arv_device_get_integer_feature_bounds", device, feature, byref(low), byref(high))
        return low.value, high.value

    def float_bounds(self, device: Pointer, feature: bytes) -> tuple[float, float]:
        """Return the least and the greatest value of a float feature."""
        low, high = c_double(), c_double()
        self.call("arv_device_get_float_feature_bounds", device, feature, byref(low), byref(high))
        return low.value, high.value

    def choices(self, device: Pointer, feature: bytes) -> tuple[str, ...]:
        """Return the entries of an enumeration that are available now."""
        count = c_uint()
        names = self.call(
            "arv_device_dup_available_enumeration_feature_values_as_strings", device, feature, byref(count)
        )
        found = tuple(names[index].decode() for index in range(count.value))
        self.call("g_free", names)
        return found

    def category(self, node: Pointer) -> Iterator[str]:
        """Yield the names that a category lists."""
        item = self.call("arv_gc_category_get_features", node)
        while item:
            yield item.contents.data.decode()
            item = item.contents.next

    def data(self, buffer: Pointer) -> npt.NDArray[np.uint8]:
        """Return the bytes of a buffer without copying them: valid until the buffer is pushed again."""
        size = c_size_t()
        address = self.call("arv_buffer_get_data", buffer, byref(size))
        if not address or not size.value:
            return np.zeros(0, np.uint8)
        return np.ctypeslib.as_array((ctypes.c_uint8 * size.value).from_address(address))

    def stream_statistics(self, stream: Pointer) -> tuple[int, int, int, int, int]:
        """Return how many frames were completed, failed and found no buffer; packets sent again, and missing."""
        values = [c_uint64() for _ in range(5)]
        self.call("arv_stream_get_statistics", stream, *(byref(value) for value in values[:3]))
        self.call("arv_gv_stream_get_statistics", stream, *(byref(value) for value in values[3:]))
        completed, failed, underruns, resent, missing = (value.value for value in values)
        return completed, failed, underruns, resent, missing
