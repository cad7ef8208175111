"""How are a camera's GenICam features read and set by name?  Through libaravis, checked and read back."""

from dataclasses import dataclass
from enum import Enum
from ipaddress import IPv4Address

from slabcell_drivers.camera.aravis_library import AravisError, AravisLibrary, DeviceFault, Pointer
from slabcell_drivers.camera.features import remedy
from slabcell_drivers.camera.protocol import CameraConfigError
from slabcell_drivers.camera.settings import FeatureValue

__all__ = ["Feature", "FeatureKind", "Features"]

MAX_FEATURES = 10_000


class FeatureKind(Enum):
    """What a feature's value is."""

    INTEGER = "integer"
    FLOAT = "float"
    BOOLEAN = "boolean"
    ENUMERATION = "enumeration"
    STRING = "string"
    COMMAND = "command"
    CATEGORY = "category"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature as the camera has it now; ``value`` is None where it cannot be read."""

    name: str
    category: str
    kind: FeatureKind
    access: str
    value: FeatureValue | None
    minimum: float | None = None
    maximum: float | None = None
    increment: int | None = None
    choices: tuple[str, ...] = ()


_ACCESS = {0: "RO", 1: "WO", 2: "RW"}
_WORDS = {FeatureKind.INTEGER: "whole number", FeatureKind.FLOAT: "number", FeatureKind.BOOLEAN: "truth value"}


class Features:
    """The features of one open device.  To be used on the thread that owns the device."""

    def __init__(self, library: AravisLibrary, device: Pointer, camera: str) -> None:
        self._library = library
        self._device = device
        self._camera = camera

    def has(self, name: str) -> bool:
        """Whether the camera has the feature now."""
        try:
            return bool(self._library.call("arv_device_is_feature_available", self._device, name.encode()))
        except AravisError as error:
            if error.code in (DeviceFault.FEATURE_NOT_FOUND, DeviceFault.WRONG_FEATURE):
                return False
            raise

    def kind(self, name: str) -> FeatureKind:
        """Say what a feature's value is.  Raises CameraConfigError if there is no such feature."""
        node = self._library.call("arv_device_get_feature", self._device, name.encode())
        if not node:
            raise CameraConfigError(f"camera {self._camera}: has no feature {name}; {remedy(self._camera)}")
        return _kind_of(self._library.text("g_type_name_from_instance", node))

    def get(self, name: str) -> FeatureValue:
        """Return a feature's value.  Raises CameraConfigError; AravisError if the camera does not answer."""
        kind, key = self.kind(name), name.encode()
        try:
            match kind:
                case FeatureKind.INTEGER:
                    return int(self._library.call("arv_device_get_integer_feature_value", self._device, key))
                case FeatureKind.FLOAT:
                    return float(self._library.call("arv_device_get_float_feature_value", self._device, key))
                case FeatureKind.BOOLEAN:
                    return bool(self._library.call("arv_device_get_boolean_feature_value", self._device, key))
                case FeatureKind.ENUMERATION | FeatureKind.STRING:
                    return self._library.text("arv_device_get_string_feature_value", self._device, key)
                case _:
                    raise CameraConfigError(f"camera {self._camera}: {name} is a {kind.value}, it has no value")
        except AravisError as error:
            raise self._refused(f"{name} cannot be read", error) from error

    def set(self, name: str, value: FeatureValue) -> None:
        """Set a feature and read it back; a command is executed.  Raises as `get`."""
        kind, key = self.kind(name), name.encode()
        if self._access(name) == "RO":
            raise CameraConfigError(
                f"camera {self._camera}: {name} = {value} is refused: it can only be read now;"
                f" {remedy(self._camera, name)}"
            )
        wanted = self._convert(name, kind, value)
        try:
            match kind:
                case FeatureKind.INTEGER:
                    self._library.call("arv_device_set_integer_feature_value", self._device, key, wanted)
                case FeatureKind.FLOAT:
                    self._library.call("arv_device_set_float_feature_value", self._device, key, wanted)
                case FeatureKind.BOOLEAN:
                    self._library.call("arv_device_set_boolean_feature_value", self._device, key, wanted)
                case FeatureKind.ENUMERATION | FeatureKind.STRING:
                    self._library.call("arv_device_set_string_feature_value", self._device, key, str(wanted).encode())
                case _:
                    self._library.call("arv_device_execute_command", self._device, key)
                    return
        except AravisError as error:
            raise self._refused(f"{name} = {value} is refused", error, name, kind) from error
        self._check(name, kind, wanted)

    def describe(self, name: str, category: str = "") -> Feature:
        """Return everything about a feature.  Raises CameraConfigError if there is none."""
        kind, access = self.kind(name), self._access(name)
        if kind in (FeatureKind.COMMAND, FeatureKind.CATEGORY, FeatureKind.OTHER) or access == "WO":
            return Feature(name, category, kind, access, None)
        try:
            value = self.get(name)
        except CameraConfigError:
            value = None
        low, high = self._bounds(name, kind)
        step = self._step(name, kind) if kind is FeatureKind.INTEGER else None
        return Feature(name, category, kind, access, value, low, high, step, self._choices(name, kind))

    def all(self) -> tuple[Feature, ...]:
        """Return every feature, in the order of the camera's own tree."""
        found: dict[str, Feature] = {}
        seen: set[str] = set()
        open_categories = ["Root"]
        while open_categories and len(found) < MAX_FEATURES:
            category = open_categories.pop(0)
            node = self._library.call("arv_device_get_feature", self._device, category.encode())
            if category in seen or not node:
                continue
            seen.add(category)
            inner: list[str] = []
            for name in self._library.category(node):
                try:
                    kind = self.kind(name)
                except CameraConfigError:
                    continue  # the camera's own description names what it does not have
                if kind is FeatureKind.CATEGORY:
                    inner.append(name)
                elif name not in found and self.has(name):
                    found[name] = self.describe(name, category)
            open_categories = inner + open_categories
        return tuple(found.values())

    def _access(self, name: str) -> str:
        node = self._library.call("arv_device_get_feature", self._device, name.encode())
        return _ACCESS.get(self._library.call("arv_gc_feature_node_get_actual_access_mode", node), "?")

    def _convert(self, name: str, kind: FeatureKind, value: FeatureValue) -> FeatureValue:
        """Return the value in the feature's own type.  Raises CameraConfigError."""
        try:
            match kind:
                case FeatureKind.BOOLEAN:
                    if isinstance(value, str):
                        return {"true": True, "1": True, "on": True, "false": False, "0": False, "off": False}[
                            value.lower()
                        ]
                    return bool(value)
                case FeatureKind.INTEGER:
                    wanted: FeatureValue = _whole(value)
                case FeatureKind.FLOAT:
                    wanted = float(value)
                case FeatureKind.ENUMERATION:
                    choices = self._choices(name, kind)
                    if str(value) not in choices:
                        raise self._wrong(f"{name} = {value} is refused", name, kind)
                    return str(value)
                case FeatureKind.CATEGORY | FeatureKind.OTHER:
                    raise CameraConfigError(f"camera {self._camera}: {name} is a {kind.value}, it cannot be set")
                case _:
                    return value
        except (ValueError, KeyError) as error:
            raise self._wrong(f"{name} = {value!r} is no {_WORDS.get(kind, kind.value)}", name, kind) from error
        low, high = self._bounds(name, kind)
        outside = low is not None and high is not None and not low <= float(wanted) <= high
        if outside or (kind is FeatureKind.INTEGER and (int(wanted) - int(low or 0)) % self._step(name, kind)):
            raise self._wrong(f"{name} = {value} is refused", name, kind)
        return wanted

    def _check(self, name: str, kind: FeatureKind, wanted: FeatureValue) -> None:
        seen = self.get(name)
        same = seen == wanted
        if kind is FeatureKind.FLOAT:
            # Cameras round to their own steps (a line time, 0.1 dB): half a percent, or a hundredth of a unit.
            same = abs(float(seen) - float(wanted)) <= max(0.005 * abs(float(wanted)), 0.011)
        if not same:
            raise self._wrong(f"{name} was set to {wanted} and reads {seen}", name, kind)

    def _bounds(self, name: str, kind: FeatureKind) -> tuple[float | None, float | None]:
        try:
            if kind is FeatureKind.INTEGER:
                return self._library.integer_bounds(self._device, name.encode())
            if kind is FeatureKind.FLOAT:
                return self._library.float_bounds(self._device, name.encode())
        except AravisError as error:
            if error.code == DeviceFault.TIMEOUT:
                raise
        return None, None

    def _choices(self, name: str, kind: FeatureKind) -> tuple[str, ...]:
        if kind is not FeatureKind.ENUMERATION:
            return ()
        return self._library.choices(self._device, name.encode())

    def _takes(self, name: str, kind: FeatureKind) -> str:
        """Say which values a feature takes."""
        low, high = self._bounds(name, kind)
        if low is not None and high is not None:
            step = self._step(name, kind)
            return f"it must be {low:.10g} to {high:.10g}" + (f" in steps of {step}" if step > 1 else "")
        choices = self._choices(name, kind)
        if choices:
            return f"it takes {', '.join(choices)}"
        return "it takes true and false" if kind is FeatureKind.BOOLEAN else "the camera does not take it"

    def _step(self, name: str, kind: FeatureKind) -> int:
        """Return the step of an integer feature, 1 where it has none."""
        if kind is not FeatureKind.INTEGER:
            return 1
        try:
            step = self._library.call("arv_device_get_integer_feature_increment", self._device, name.encode())
            return max(1, int(step))
        except AravisError as error:
            if error.code == DeviceFault.TIMEOUT:
                raise
            return 1

    def _wrong(self, what: str, name: str, kind: FeatureKind) -> CameraConfigError:
        """Return an error that says what the feature takes, and where to look."""
        return CameraConfigError(
            f"camera {self._camera}: {what}: {self._takes(name, kind)}; {remedy(self._camera, name)}"
        )

    def _refused(self, what: str, error: AravisError, name: str = "", kind: FeatureKind | None = None) -> Exception:
        """Return a configuration error, or the library's own if the camera did not answer or obeys another client."""
        if error.code in (DeviceFault.TIMEOUT, DeviceFault.NOT_CONNECTED) or "access-denied" in str(error):
            return error
        if kind is None:
            return CameraConfigError(f"camera {self._camera}: {what}: {error}")
        return self._wrong(f"{what} ({error})", name, kind)


def _whole(value: FeatureValue) -> int:
    """Return a whole number; text may be hexadecimal, or an IPv4 address as cameras have it.  Raises ValueError."""
    if isinstance(value, str):
        return int(IPv4Address(value)) if value.count(".") == 3 else int(value, 0)
    if value != int(value):
        raise ValueError(value)
    return int(value)


def _kind_of(type_name: str) -> FeatureKind:
    exact = {
        "ArvGcBoolean": FeatureKind.BOOLEAN,
        "ArvGcEnumeration": FeatureKind.ENUMERATION,
        "ArvGcCommand": FeatureKind.COMMAND,
        "ArvGcCategory": FeatureKind.CATEGORY,
        "ArvGcStringNode": FeatureKind.STRING,
        "ArvGcStringRegNode": FeatureKind.STRING,
        "ArvGcRegisterNode": FeatureKind.OTHER,
    }
    if type_name in exact:
        return exact[type_name]
    if "Int" in type_name:
        return FeatureKind.INTEGER
    if any(part in type_name for part in ("Float", "SwissKnife", "Converter")):
        return FeatureKind.FLOAT
    return FeatureKind.OTHER
