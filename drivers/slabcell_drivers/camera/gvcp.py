"""How do a GigE Vision camera and its client talk about control?  The bytes of GVCP: requests, answers, discovery.

Pure functions, no socket: discovery and force-IP use them as a client, the camera in software as a device.

Source: GigE Vision specification 1.2 (AIA), GVCP: header, commands, status codes and bootstrap registers.
"""

import struct
from dataclasses import dataclass, field
from enum import IntEnum
from ipaddress import IPv4Address
from typing import Final

__all__ = [
    "CCP_CONTROL",
    "CCP_EXCLUSIVE",
    "DISCOVERY_BYTES",
    "MAX_MEMORY_BYTES",
    "PORT",
    "Answer",
    "Command",
    "Device",
    "GvcpError",
    "Register",
    "Request",
    "Status",
    "decode_answer",
    "decode_device",
    "decode_request",
    "encode_answer",
    "encode_device",
    "encode_force_ip",
    "encode_request",
    "text_field",
]

PORT: Final = 3956
KEY: Final = 0x42
NEEDS_ANSWER: Final = 0x01
HEADER: Final = struct.Struct(">BBHHH")
ANSWER_HEADER: Final = struct.Struct(">HHHH")
MAX_MEMORY_BYTES: Final = 536
"""Most bytes that one READMEM or WRITEMEM may carry: a GVCP datagram never exceeds 576 bytes."""
DISCOVERY_BYTES: Final = 248
_LOOPBACK_MASK: Final = IPv4Address("255.0.0.0")
_NO_GATEWAY: Final = IPv4Address(0)
CCP_EXCLUSIVE: Final = 1
CCP_CONTROL: Final = 2


class Command(IntEnum):
    """What a request asks; the answer's number is one higher."""

    DISCOVERY = 0x0002
    FORCE_IP = 0x0004
    PACKET_RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086


class Status(IntEnum):
    """What an answer, or a packet of the stream, says about itself."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    INVALID_HEADER = 0x800B
    PACKET_UNAVAILABLE = 0x800C


class Register(IntEnum):
    """Bootstrap registers: every GigE Vision device has them at these addresses."""

    VERSION = 0x0000
    DEVICE_MODE = 0x0004
    MAC_HIGH = 0x0008
    MAC_LOW = 0x000C
    SUPPORTED_IP_CONFIGURATION = 0x0010
    CURRENT_IP_CONFIGURATION = 0x0014
    CURRENT_IP = 0x0024
    CURRENT_SUBNET = 0x0034
    CURRENT_GATEWAY = 0x0044
    VENDOR_NAME = 0x0048
    MODEL_NAME = 0x0068
    DEVICE_VERSION = 0x0088
    VENDOR_INFORMATION = 0x00A8
    SERIAL_NUMBER = 0x00D8
    USER_NAME = 0x00E8
    FIRST_URL = 0x0200
    SECOND_URL = 0x0400
    INTERFACES = 0x0600
    PERSISTENT_IP = 0x064C
    PERSISTENT_SUBNET = 0x065C
    PERSISTENT_GATEWAY = 0x066C
    LINK_SPEED = 0x0670
    MESSAGE_CHANNELS = 0x0900
    STREAM_CHANNELS = 0x0904
    STREAM_CAPABILITY = 0x092C
    GVCP_CAPABILITY = 0x0934
    HEARTBEAT_TIMEOUT = 0x0938
    TICK_FREQUENCY_HIGH = 0x093C
    TICK_FREQUENCY_LOW = 0x0940
    TIMESTAMP_CONTROL = 0x0944
    TIMESTAMP_HIGH = 0x0948
    TIMESTAMP_LOW = 0x094C
    CONTROL_PRIVILEGE = 0x0A00
    STREAM_PORT = 0x0D00
    STREAM_PACKET_SIZE = 0x0D04
    STREAM_PACKET_DELAY = 0x0D08
    STREAM_DESTINATION = 0x0D18
    STREAM_SOURCE_PORT = 0x0D1C


class GvcpError(Exception):
    """A datagram is not GVCP; the message says why.  ``status`` is what a device answers, if it answers."""

    def __init__(self, message: str, status: Status = Status.INVALID_HEADER) -> None:
        super().__init__(message)
        self.status = status


@dataclass(frozen=True, slots=True)
class Request:
    """What a client asks.  ``command`` is a plain number: a device must answer unknown ones too."""

    command: int
    number: int
    body: bytes = b""
    flags: int = NEEDS_ANSWER

    @property
    def needs_answer(self) -> bool:
        """Whether the client waits for an answer."""
        return bool(self.flags & NEEDS_ANSWER)


@dataclass(frozen=True, slots=True)
class Answer:
    """What a device answers; ``number`` is that of the request."""

    status: int
    command: int
    number: int
    body: bytes = b""


@dataclass(frozen=True, slots=True)
class Device:
    """Who a device says it is, as it answers a discovery."""

    vendor: str
    model: str
    serial: str
    address: IPv4Address
    mac: bytes
    user_name: str = ""
    version: str = ""
    subnet: IPv4Address = field(default=_LOOPBACK_MASK)
    gateway: IPv4Address = field(default=_NO_GATEWAY)

    @property
    def mac_text(self) -> str:
        """Return the MAC address as people write it."""
        return ":".join(f"{byte:02x}" for byte in self.mac)


def encode_request(request: Request) -> bytes:
    """Return the datagram of a request."""
    return HEADER.pack(KEY, request.flags, request.command, len(request.body), request.number) + request.body


def decode_request(datagram: bytes) -> Request:
    """Return what a client asks.  Raises GvcpError."""
    if len(datagram) < HEADER.size:
        raise GvcpError(f"{len(datagram)} bytes are no GVCP request: its header alone has {HEADER.size}")
    key, flags, command, length, number = HEADER.unpack_from(datagram)
    if key != KEY:
        raise GvcpError(f"key 0x{key:02x} is not GVCP's 0x{KEY:02x}")
    if len(datagram) < HEADER.size + length:
        raise GvcpError(f"the header promises {length} bytes, {len(datagram) - HEADER.size} came")
    return Request(command, number, datagram[HEADER.size : HEADER.size + length], flags)


def encode_answer(answer: Answer) -> bytes:
    """Return the datagram of an answer."""
    return ANSWER_HEADER.pack(answer.status, answer.command, len(answer.body), answer.number) + answer.body


def decode_answer(datagram: bytes) -> Answer:
    """Return what a device answered.  Raises GvcpError."""
    if len(datagram) < ANSWER_HEADER.size:
        raise GvcpError(f"{len(datagram)} bytes are no GVCP answer: its header alone has {ANSWER_HEADER.size}")
    status, command, length, number = ANSWER_HEADER.unpack_from(datagram)
    if len(datagram) < ANSWER_HEADER.size + length:
        raise GvcpError(f"the header promises {length} bytes, {len(datagram) - ANSWER_HEADER.size} came")
    return Answer(status, command, number, datagram[ANSWER_HEADER.size : ANSWER_HEADER.size + length])


def encode_device(device: Device) -> bytes:
    """Return the 248 bytes by which a device introduces itself: its first bootstrap registers."""
    block = bytearray(DISCOVERY_BYTES)
    struct.pack_into(">II", block, Register.VERSION, 0x0001_0002, 0x8000_0001)  # GEV 1.2; big-endian, UTF-8
    block[Register.MAC_HIGH + 2 : Register.MAC_HIGH + 8] = device.mac
    struct.pack_into(
        ">II", block, Register.SUPPORTED_IP_CONFIGURATION, 0x5, 0x1
    )  # persistent and link-local; the first
    for register, address in (
        (Register.CURRENT_IP, device.address),
        (Register.CURRENT_SUBNET, device.subnet),
        (Register.CURRENT_GATEWAY, device.gateway),
    ):
        block[register : register + 4] = address.packed
    for register, text, size in (
        (Register.VENDOR_NAME, device.vendor, 32),
        (Register.MODEL_NAME, device.model, 32),
        (Register.DEVICE_VERSION, device.version, 32),
        (Register.SERIAL_NUMBER, device.serial, 16),
        (Register.USER_NAME, device.user_name, 16),
    ):
        block[register : register + size] = text_field(text, size)
    return bytes(block)


def decode_device(block: bytes) -> Device:
    """Return who answered a discovery.  Raises GvcpError."""
    if len(block) < DISCOVERY_BYTES:
        raise GvcpError(f"a discovery answer has {DISCOVERY_BYTES} bytes, this one {len(block)}")

    def address(register: Register) -> IPv4Address:
        return IPv4Address(block[register : register + 4])

    def text(register: Register, size: int) -> str:
        return block[register : register + size].split(b"\0", 1)[0].decode("utf-8", "replace")

    return Device(
        vendor=text(Register.VENDOR_NAME, 32),
        model=text(Register.MODEL_NAME, 32),
        serial=text(Register.SERIAL_NUMBER, 16),
        address=address(Register.CURRENT_IP),
        mac=block[Register.MAC_HIGH + 2 : Register.MAC_HIGH + 8],
        user_name=text(Register.USER_NAME, 16),
        version=text(Register.DEVICE_VERSION, 32),
        subnet=address(Register.CURRENT_SUBNET),
        gateway=address(Register.CURRENT_GATEWAY),
    )


def encode_force_ip(mac: bytes, address: IPv4Address, subnet: IPv4Address, gateway: IPv4Address) -> bytes:
    """Return the body of FORCE_IP: the device with this MAC address takes these addresses until its next start."""
    body = bytearray(56)
    body[2:8] = mac
    for place, value in ((20, address), (36, subnet), (52, gateway)):
        body[place : place + 4] = value.packed
    return bytes(body)


def text_field(text: str, size: int) -> bytes:
    """Return UTF-8 text padded with zeros to a register's size, cut so that the last byte stays zero."""
    return text.encode()[: size - 1].decode("utf-8", "ignore").encode().ljust(size, b"\0")
