"""How is a GenICam camera set as a cell wants it?  Which features in which order, whatever library writes them."""

from typing import Protocol

from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS
from slabcell_drivers.camera.protocol import CameraConfigError, CameraInfo
from slabcell_drivers.camera.settings import CameraSettings, FeatureValue

__all__ = ["FeatureAccess", "apply_features", "apply_settings", "read_info", "remedy"]


class FeatureAccess(Protocol):
    """A camera's features by name.  `set` reads back; all raise CameraConfigError or the library's own errors."""

    def has(self, name: str) -> bool:
        """Whether the camera has the feature now."""
        ...

    def get(self, name: str) -> FeatureValue:
        """Return its value."""
        ...

    def set(self, name: str, value: FeatureValue) -> None:
        """Give it a value, and see that it took it."""
        ...


def apply_settings(features: FeatureAccess, wanted: CameraSettings, camera: str) -> None:
    """Have the camera wait for software triggers, with the picture that is wanted.  Raises as `FeatureAccess`."""
    for name, value in (("GevHeartbeatTimeout", wanted.heartbeat_ms), ("AcquisitionMode", "Continuous"),
                        ("TriggerSelector", "FrameStart"), ("TriggerMode", "On"),
                        ("TriggerSource", "Software")):  # fmt: skip
        if features.has(name):
            features.set(name, value)
    # A smaller picture first, so that no offset is out of range on the way.
    for name in ("OffsetX", "OffsetY"):
        if features.has(name) and (wanted.width or wanted.height):
            features.set(name, 0)
    for names, value in ((("PixelFormat",), wanted.pixel_format),
                         (("Width",), wanted.width), (("Height",), wanted.height),
                         (("OffsetX",), wanted.offset_x), (("OffsetY",), wanted.offset_y),
                         (("ExposureTime", "ExposureTimeAbs"), wanted.exposure_us),
                         (("Gain", "GainRaw"), wanted.gain_db)):  # fmt: skip
        if value is None:
            continue
        name = _first_of(features, *names)
        if name is None:
            raise CameraConfigError(
                f"camera {camera}: has no feature {' or '.join(names)}, so it cannot be set to {value};"
                f" {remedy(camera)}"
            )
        features.set(name, value)


def apply_features(features: FeatureAccess, wanted: CameraSettings) -> None:
    """Set what the cell names by GenICam names, in the order given.  Raises as `FeatureAccess`."""
    for name, value in wanted.features.items():
        features.set(name, value)


def read_info(features: FeatureAccess, camera: str) -> CameraInfo:
    """Return which camera this is and what its pictures look like now.  Raises as `FeatureAccess`."""
    pixel_format = str(features.get("PixelFormat"))
    if pixel_format not in PIXEL_FORMATS:
        raise CameraConfigError(
            f"camera {camera}: PixelFormat = {pixel_format} cannot be decoded; set one of {', '.join(PIXEL_FORMATS)}"
        )
    texts = (("DeviceVendorName",), ("DeviceModelName",), ("DeviceSerialNumber", "DeviceID"))
    vendor, model, serial = (
        str(features.get(name)) if (name := _first_of(features, *names)) else "" for names in texts
    )
    return CameraInfo(vendor, model, serial, int(features.get("Width")), int(features.get("Height")), pixel_format)


def remedy(camera: str, feature: str = "") -> str:
    """Say where a person finds what a camera takes."""
    return f"`slabcell camera info {camera}{' ' if feature else ''}{feature}` shows what it has and takes"


def _first_of(features: FeatureAccess, *names: str) -> str | None:
    return next((name for name in names if features.has(name)), None)
