"""Which features does the camera in software have?  One table; the GenICam XML and the register checks read it.

Names, units and meanings are those of the EMVA's Standard Features Naming Convention (SFNC 2.4), the registers of
`Gev...` features those of GigE Vision 1.2.
"""

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final

from slabcell_drivers.camera.gvcp import Register
from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS

__all__ = [
    "FEATURE_BASE",
    "FEATURE_BYTES",
    "MAX_PACKET_BYTES",
    "MIN_PACKET_BYTES",
    "Feature",
    "Kind",
    "Place",
    "SensorLimits",
    "feature_table",
]

FEATURE_BASE: Final = 0x0001_0000
FEATURE_BYTES: Final = 0x200
MIN_PACKET_BYTES: Final = 576
MAX_PACKET_BYTES: Final = 9000


class Place(IntEnum):
    """Registers of the features that are not bootstrap registers."""

    SENSOR_WIDTH = FEATURE_BASE
    SENSOR_HEIGHT = FEATURE_BASE + 0x04
    WIDTH = FEATURE_BASE + 0x10
    HEIGHT = FEATURE_BASE + 0x14
    OFFSET_X = FEATURE_BASE + 0x18
    OFFSET_Y = FEATURE_BASE + 0x1C
    PIXEL_FORMAT = FEATURE_BASE + 0x20
    PAYLOAD_SIZE = FEATURE_BASE + 0x24
    ACQUISITION_MODE = FEATURE_BASE + 0x40
    ACQUISITION_START = FEATURE_BASE + 0x44
    ACQUISITION_STOP = FEATURE_BASE + 0x48
    FRAME_RATE_ENABLE = FEATURE_BASE + 0x4C
    FRAME_RATE = FEATURE_BASE + 0x50
    TRIGGER_SELECTOR = FEATURE_BASE + 0x60
    TRIGGER_MODE = FEATURE_BASE + 0x64
    TRIGGER_SOURCE = FEATURE_BASE + 0x68
    TRIGGER_SOFTWARE = FEATURE_BASE + 0x6C
    EXPOSURE_TIME = FEATURE_BASE + 0x80
    GAIN = FEATURE_BASE + 0x84
    TEMPERATURE = FEATURE_BASE + 0xA0
    DEVICE_RESET = FEATURE_BASE + 0xA4
    PARAMETERS_LOCKED = FEATURE_BASE + 0xB0


class Kind(Enum):
    """What a feature's value is, in GenICam's words."""

    INTEGER = "Integer"
    FLOAT = "Float"
    BOOLEAN = "Boolean"
    ENUMERATION = "Enumeration"
    COMMAND = "Command"
    STRING = "String"


@dataclass(frozen=True, slots=True)
class Feature:
    """One feature.  ``bits`` is (first, last) of a part of its register, bit 31 the lowest, as GenICam counts them.

    ``locked`` features refuse to change while the camera streams.
    """

    name: str
    category: str
    kind: Kind
    address: int
    access: str = "RW"
    minimum: float = 0
    maximum: float = 0xFFFF_FFFF
    increment: int = 1
    unit: str = ""
    entries: tuple[tuple[str, int], ...] = ()
    length: int = 4
    bits: tuple[int, int] | None = None
    command_value: int = 1
    locked: bool = False
    tooltip: str = ""


@dataclass(frozen=True, slots=True)
class SensorLimits:
    """What the sensor can do."""

    width: int = 1920
    height: int = 1200
    max_frame_rate_hz: float = 1000.0
    min_exposure_us: float = 15.0
    max_exposure_us: float = 1_000_000.0
    max_gain_db: float = 24.0


_DEVICE, _IMAGE, _ACQUISITION = "DeviceControl", "ImageFormatControl", "AcquisitionControl"
_ANALOG, _TRANSPORT = "AnalogControl", "TransportLayerControl"
_ADDRESS = 0xFFFF_FFFF


def feature_table(limits: SensorLimits) -> tuple[Feature, ...]:
    """Return every feature of a camera with such a sensor."""
    return (*_device(), *_image(limits), *_acquisition(limits), *_transport(limits))


def _device() -> tuple[Feature, ...]:
    def text(name: str, register: Register, length: int, access: str = "RO") -> Feature:
        return Feature(name, _DEVICE, Kind.STRING, register, access, length=length)

    return (
        text("DeviceVendorName", Register.VENDOR_NAME, 32),
        text("DeviceModelName", Register.MODEL_NAME, 32),
        text("DeviceVersion", Register.DEVICE_VERSION, 32),
        text("DeviceManufacturerInfo", Register.VENDOR_INFORMATION, 48),
        text("DeviceSerialNumber", Register.SERIAL_NUMBER, 16),
        text("DeviceUserID", Register.USER_NAME, 16, "RW"),
        Feature("DeviceTemperature", _DEVICE, Kind.FLOAT, Place.TEMPERATURE, "RO", -100, 200, unit="C"),
        Feature("DeviceReset", _DEVICE, Kind.COMMAND, Place.DEVICE_RESET, "WO"),
    )


def _image(limits: SensorLimits) -> tuple[Feature, ...]:
    width, height = limits.width, limits.height
    formats = tuple((name, form.code) for name, form in PIXEL_FORMATS.items() if name != "BGR8")
    return (
        Feature("SensorWidth", _IMAGE, Kind.INTEGER, Place.SENSOR_WIDTH, "RO", 1, width, unit="px"),
        Feature("SensorHeight", _IMAGE, Kind.INTEGER, Place.SENSOR_HEIGHT, "RO", 1, height, unit="px"),
        Feature("WidthMax", _IMAGE, Kind.INTEGER, Place.SENSOR_WIDTH, "RO", 1, width, unit="px"),
        Feature("HeightMax", _IMAGE, Kind.INTEGER, Place.SENSOR_HEIGHT, "RO", 1, height, unit="px"),
        Feature("Width", _IMAGE, Kind.INTEGER, Place.WIDTH, "RW", 4, width, 4, "px", locked=True),
        Feature("Height", _IMAGE, Kind.INTEGER, Place.HEIGHT, "RW", 1, height, 1, "px", locked=True),
        Feature("OffsetX", _IMAGE, Kind.INTEGER, Place.OFFSET_X, "RW", 0, width - 4, 4, "px"),
        Feature("OffsetY", _IMAGE, Kind.INTEGER, Place.OFFSET_Y, "RW", 0, height - 1, 1, "px"),
        Feature(
            "PixelFormat", _IMAGE, Kind.ENUMERATION, Place.PIXEL_FORMAT, entries=formats, locked=True,
            tooltip="How the bytes of a picture are to be read.",
        ),
    )  # fmt: skip


def _acquisition(limits: SensorLimits) -> tuple[Feature, ...]:
    def choice(name: str, place: Place, *entries: str, locked: bool = False) -> Feature:
        numbered = tuple((entry, number) for number, entry in enumerate(entries))
        return Feature(name, _ACQUISITION, Kind.ENUMERATION, place, entries=numbered, locked=locked)

    return (
        choice("AcquisitionMode", Place.ACQUISITION_MODE, "Continuous", "SingleFrame", locked=True),
        Feature("AcquisitionStart", _ACQUISITION, Kind.COMMAND, Place.ACQUISITION_START, "WO"),
        Feature("AcquisitionStop", _ACQUISITION, Kind.COMMAND, Place.ACQUISITION_STOP, "WO"),
        Feature("AcquisitionFrameRateEnable", _ACQUISITION, Kind.BOOLEAN, Place.FRAME_RATE_ENABLE, maximum=1),
        Feature(
            "AcquisitionFrameRate", _ACQUISITION, Kind.FLOAT, Place.FRAME_RATE, "RW", 0.1, limits.max_frame_rate_hz,
            unit="Hz",
        ),
        choice("TriggerSelector", Place.TRIGGER_SELECTOR, "FrameStart"),
        choice("TriggerMode", Place.TRIGGER_MODE, "Off", "On"),
        choice("TriggerSource", Place.TRIGGER_SOURCE, "Software", "Line0"),
        Feature("TriggerSoftware", _ACQUISITION, Kind.COMMAND, Place.TRIGGER_SOFTWARE, "WO"),
        Feature(
            "ExposureTime", _ACQUISITION, Kind.FLOAT, Place.EXPOSURE_TIME, "RW", limits.min_exposure_us,
            limits.max_exposure_us, unit="us",
        ),
        Feature("Gain", _ANALOG, Kind.FLOAT, Place.GAIN, "RW", 0, limits.max_gain_db, unit="dB"),
    )  # fmt: skip


def _transport(limits: SensorLimits) -> tuple[Feature, ...]:
    def number(
        name: str, register: int, access: str = "RW", maximum: int = _ADDRESS, minimum: int = 0, length: int = 4
    ) -> Feature:
        return Feature(name, _TRANSPORT, Kind.INTEGER, register, access, minimum, maximum, length=length)

    size = Register.STREAM_PACKET_SIZE
    privileges = (("OpenAccess", 0), ("ExclusiveAccess", 1), ("ControlAccess", 2))
    return (
        number("PayloadSize", Place.PAYLOAD_SIZE, "RO", limits.width * limits.height * 3),
        number("GevCurrentIPAddress", Register.CURRENT_IP, "RO"),
        number("GevCurrentSubnetMask", Register.CURRENT_SUBNET, "RO"),
        number("GevCurrentDefaultGateway", Register.CURRENT_GATEWAY, "RO"),
        number("GevPersistentIPAddress", Register.PERSISTENT_IP),
        number("GevPersistentSubnetMask", Register.PERSISTENT_SUBNET),
        number("GevPersistentDefaultGateway", Register.PERSISTENT_GATEWAY),
        number("GevStreamChannelCount", Register.STREAM_CHANNELS, "RO"),
        number("GevHeartbeatTimeout", Register.HEARTBEAT_TIMEOUT, minimum=500, maximum=600_000),
        number("GevTimestampTickFrequency", Register.TICK_FREQUENCY_HIGH, "RO", 2**62, length=8),
        Feature("GevTimestampControlLatch", _TRANSPORT, Kind.COMMAND, Register.TIMESTAMP_CONTROL, "WO",
                command_value=2),
        number("GevTimestampValue", Register.TIMESTAMP_HIGH, "RO", 2**62, length=8),
        Feature("GevCCP", _TRANSPORT, Kind.ENUMERATION, Register.CONTROL_PRIVILEGE, entries=privileges),
        Feature("GevSCPHostPort", _TRANSPORT, Kind.INTEGER, Register.STREAM_PORT, maximum=0xFFFF, bits=(16, 31)),
        Feature("GevSCPSFireTestPacket", _TRANSPORT, Kind.BOOLEAN, size, maximum=1, bits=(0, 0)),
        Feature("GevSCPSDoNotFragment", _TRANSPORT, Kind.BOOLEAN, size, maximum=1, bits=(1, 1)),
        Feature("GevSCPSPacketSize", _TRANSPORT, Kind.INTEGER, size, minimum=MIN_PACKET_BYTES,
                maximum=MAX_PACKET_BYTES, increment=4, unit="B", bits=(16, 31)),
        number("GevSCPD", Register.STREAM_PACKET_DELAY, maximum=100_000_000),
        number("GevSCDA", Register.STREAM_DESTINATION),
        number("TLParamsLocked", Place.PARAMETERS_LOCKED, maximum=1),
    )  # fmt: skip
