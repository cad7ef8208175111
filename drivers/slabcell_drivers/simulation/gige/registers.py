"""What is in the registers of the camera in software, and what may be written where?  Bootstrap, features, XML.

Who may write is the business of `control`.  Source: GigE Vision 1.2, bootstrap registers.
"""

import struct
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Final

from slabcell_drivers.camera.gvcp import DISCOVERY_BYTES, MAX_MEMORY_BYTES, Device, Register, Status, encode_device
from slabcell_drivers.camera.pixel_formats import PixelFormat, format_of_code
from slabcell_drivers.simulation.gige.features import (
    FEATURE_BASE,
    FEATURE_BYTES,
    MAX_PACKET_BYTES,
    MIN_PACKET_BYTES,
    Feature,
    Kind,
    Place,
    SensorLimits,
    feature_table,
)
from slabcell_drivers.simulation.gige.xml import describe

__all__ = ["RefusedError", "Registers", "StreamSettings"]

XML_BASE: Final = 0x0010_0000
BOOTSTRAP_BYTES: Final = 0x1000
TICKS_PER_S: Final = 1_000_000_000
DEFAULT_HEARTBEAT_MS: Final = 3000
_SIZE_MASK: Final = 0xFFFF
_WORD: Final = struct.Struct(">I")
_FLOAT: Final = struct.Struct(">f")


class RefusedError(Exception):
    """A request is refused; ``status`` is what the client is told."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


@dataclass(frozen=True, slots=True)
class StreamSettings:
    """What the sensor and the stream need of the registers, at one moment."""

    width: int
    height: int
    offset_x: int
    offset_y: int
    pixel_format: PixelFormat
    exposure_us: float
    gain_db: float
    triggered: bool
    frame_rate_hz: float
    single: bool
    destination: tuple[str, int]
    packet_size: int
    packet_delay_ns: int


class Registers:
    """The memory of one camera.  Times are of any monotonic clock, in seconds."""

    def __init__(self, device: Device, limits: SensorLimits, *, started_s: float) -> None:
        self._device = device
        self._limits = limits
        self._started_s = started_s
        features = feature_table(limits)
        self._xml = describe(device.vendor, device.model, features)
        self._bootstrap = bytearray(BOOTSTRAP_BYTES)
        self._values = bytearray(FEATURE_BYTES)
        self._writable = {f.address: f for f in features if f.access != "RO" and f.kind is not Kind.STRING}
        self.load_defaults()

    @property
    def settings(self) -> StreamSettings:
        """Return what sensor and stream need, as it is now."""
        port = self.word(Register.STREAM_PORT) & 0xFFFF
        return StreamSettings(
            width=self.word(Place.WIDTH),
            height=self.word(Place.HEIGHT),
            offset_x=self.word(Place.OFFSET_X),
            offset_y=self.word(Place.OFFSET_Y),
            pixel_format=format_of_code(self.word(Place.PIXEL_FORMAT)),
            exposure_us=self._float(Place.EXPOSURE_TIME),
            gain_db=self._float(Place.GAIN),
            triggered=bool(self.word(Place.TRIGGER_MODE)),
            frame_rate_hz=self._float(Place.FRAME_RATE),
            single=bool(self.word(Place.ACQUISITION_MODE)),
            destination=(str(IPv4Address(self.word(Register.STREAM_DESTINATION))), port),
            packet_size=self.word(Register.STREAM_PACKET_SIZE) & _SIZE_MASK,
            packet_delay_ns=self.word(Register.STREAM_PACKET_DELAY) * TICKS_PER_S // TICKS_PER_S,
        )

    @property
    def heartbeat_s(self) -> float:
        """Return how long a silent controller keeps its privilege."""
        return self.word(Register.HEARTBEAT_TIMEOUT) / 1000

    def introduce(self, device: Device) -> None:
        """Be this device from now on."""
        self._device = device
        self._bootstrap[:DISCOVERY_BYTES] = encode_device(device)

    def introduction(self) -> bytes:
        """Return the answer to a discovery."""
        return bytes(self._bootstrap[:DISCOVERY_BYTES])

    def writable(self, address: int) -> Feature:
        """Return the feature whose register this is.  Raises RefusedError."""
        if address % 4:
            raise RefusedError(Status.BAD_ALIGNMENT)
        feature = self._writable.get(address)
        if feature is None:
            known = address < BOOTSTRAP_BYTES or 0 <= address - FEATURE_BASE < FEATURE_BYTES
            raise RefusedError(Status.WRITE_PROTECT if known else Status.INVALID_ADDRESS)
        return feature

    def write(self, feature: Feature, value: int) -> None:
        """Write a value into a feature's register.  Raises RefusedError."""
        self._check(feature, value)
        self.set_word(feature.address, value)

    def write_user_name(self, data: bytes) -> None:
        """Write the name that a user gave the camera."""
        self._bootstrap[Register.USER_NAME : Register.USER_NAME + 16] = data[:16].ljust(16, b"\0")

    def write_packet_size(self, value: int) -> None:
        """Write the packet size register, whose uppermost bits are no size.  Raises RefusedError."""
        size = value & _SIZE_MASK
        if not MIN_PACKET_BYTES <= size <= MAX_PACKET_BYTES or size % 4:
            raise RefusedError(Status.INVALID_PARAMETER)
        self.set_word(Register.STREAM_PACKET_SIZE, value & 0x7FFF_FFFF)

    def restart_clock(self, now_s: float) -> None:
        """Count the device's time from now on."""
        self._started_s = now_s

    def read(self, address: int, count: int, now_s: float) -> bytes:
        """Return ``count`` bytes from ``address``.  Raises RefusedError."""
        if address % 4 or count % 4:
            raise RefusedError(Status.BAD_ALIGNMENT)
        if not 0 < count <= MAX_MEMORY_BYTES:
            raise RefusedError(Status.INVALID_PARAMETER)
        if address + count <= BOOTSTRAP_BYTES:
            if address in (Register.TIMESTAMP_HIGH, Register.TIMESTAMP_LOW):
                self.latch(now_s)
            return bytes(self._bootstrap[address : address + count])
        if address >= FEATURE_BASE and address + count <= FEATURE_BASE + FEATURE_BYTES:
            if address <= Place.PAYLOAD_SIZE < address + count:
                self.set_word(Place.PAYLOAD_SIZE, self._payload())
            start = address - FEATURE_BASE
            return bytes(self._values[start : start + count])
        if XML_BASE <= address < XML_BASE + len(self._xml):
            start = address - XML_BASE
            return self._xml[start : start + count].ljust(count, b"\0")
        raise RefusedError(Status.INVALID_ADDRESS)

    def _check(self, feature: Feature, value: int) -> None:
        number: float = value
        if feature.kind is Kind.FLOAT:
            (number,) = _FLOAT.unpack(_WORD.pack(value))
            # A limit that a client rounds to single precision is still that limit.
            slack = 1e-6 * max(abs(feature.minimum), abs(feature.maximum))
            if not feature.minimum - slack <= number <= feature.maximum + slack:
                raise RefusedError(Status.INVALID_PARAMETER)
            return
        if feature.kind is Kind.ENUMERATION:
            if value not in (entry for _, entry in feature.entries):
                raise RefusedError(Status.INVALID_PARAMETER)
            return
        if not feature.minimum <= value <= feature.maximum or (value - int(feature.minimum)) % feature.increment:
            raise RefusedError(Status.INVALID_PARAMETER)
        for offset, size, limit in (
            (Place.OFFSET_X, Place.WIDTH, self._limits.width),
            (Place.OFFSET_Y, Place.HEIGHT, self._limits.height),
        ):
            if feature.address in (offset, size):
                other = size if feature.address == offset else offset
                if value + self.word(other) > limit:
                    raise RefusedError(Status.INVALID_PARAMETER)

    def load_defaults(self) -> None:
        """Be as after switching on."""
        self._bootstrap[:DISCOVERY_BYTES] = encode_device(self._device)
        url = f"Local:slabcell_gige_1_0_0.xml;{XML_BASE:X};{len(self._xml):X}".encode()
        self._bootstrap[Register.FIRST_URL : Register.FIRST_URL + len(url)] = url
        bootstrap: dict[int, int] = {
            Register.INTERFACES: 1,
            Register.LINK_SPEED: 1000,
            Register.STREAM_CHANNELS: 1,
            # user name and serial number are there; packet resend, WRITEMEM and several registers a request
            Register.GVCP_CAPABILITY: 0xC000_0000 | 0x0000_0007,
            Register.HEARTBEAT_TIMEOUT: DEFAULT_HEARTBEAT_MS,
            Register.TICK_FREQUENCY_LOW: TICKS_PER_S,
            Register.STREAM_PACKET_SIZE: 1500,
        }
        width, height = self._limits.width, self._limits.height
        features: dict[int, int] = {
            Place.SENSOR_WIDTH: width,
            Place.SENSOR_HEIGHT: height,
            Place.WIDTH: width,
            Place.HEIGHT: height,
            Place.OFFSET_X: 0,
            Place.OFFSET_Y: 0,
            Place.PIXEL_FORMAT: 0x0108_0001,
            Place.ACQUISITION_MODE: 0,
            Place.FRAME_RATE_ENABLE: 1,
            Place.TRIGGER_MODE: 0,
            Place.TRIGGER_SOURCE: 0,
        }
        for address, value in (bootstrap | features).items():
            self.set_word(address, value)
        floats = {Place.FRAME_RATE: 25.0, Place.EXPOSURE_TIME: 5000.0, Place.GAIN: 0.0, Place.TEMPERATURE: 41.5}
        for address, number in floats.items():
            self.set_word(address, _WORD.unpack(_FLOAT.pack(number))[0])

    def latch(self, now_s: float) -> None:
        """Take the device's time into its register."""
        ticks = max(0, int((now_s - self._started_s) * TICKS_PER_S))
        struct.pack_into(">Q", self._bootstrap, Register.TIMESTAMP_HIGH, ticks)

    def _payload(self) -> int:
        form = format_of_code(self.word(Place.PIXEL_FORMAT))
        return form.frame_bytes(self.word(Place.WIDTH), self.word(Place.HEIGHT))

    def word(self, address: int) -> int:
        """Return a register's value."""
        if address < BOOTSTRAP_BYTES:
            return int(_WORD.unpack_from(self._bootstrap, address)[0])
        return int(_WORD.unpack_from(self._values, address - FEATURE_BASE)[0])

    def _float(self, address: int) -> float:
        return float(_FLOAT.unpack_from(self._values, address - FEATURE_BASE)[0])

    def set_word(self, address: int, value: int) -> None:
        """Put a value into a register, unchecked."""
        if address < BOOTSTRAP_BYTES:
            _WORD.pack_into(self._bootstrap, address, value)
        else:
            _WORD.pack_into(self._values, address - FEATURE_BASE, value)
