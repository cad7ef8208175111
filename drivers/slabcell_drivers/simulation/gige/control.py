"""What does the camera in software answer on its control channel?  Registers, privilege and heartbeat; no socket.

`Control.handle` takes a datagram and gives the answer's bytes and what is to happen besides: a frame, a test packet.

Source: GigE Vision 1.2, control channel privilege and heartbeat; bootstrap registers.
"""

import struct
from dataclasses import dataclass
from enum import Enum, auto
from ipaddress import IPv4Address, IPv4Network
from typing import Final

from slabcell_drivers.camera.gvcp import (
    CCP_CONTROL,
    CCP_EXCLUSIVE,
    MAX_MEMORY_BYTES,
    Answer,
    Command,
    Device,
    GvcpError,
    Register,
    Request,
    Status,
    decode_request,
    encode_answer,
)
from slabcell_drivers.simulation.gige.features import Kind, Place, SensorLimits
from slabcell_drivers.simulation.gige.registers import RefusedError, Registers, StreamSettings

__all__ = ["LOOPBACK", "Action", "AddressForced", "Control", "Effect", "Reaction", "ResendWanted"]

Address = tuple[str, int]

LOOPBACK: Final = IPv4Network("127.0.0.0/8")
"""Where cameras in software live."""
_FIRE: Final = 0x8000_0000
_WORD: Final = struct.Struct(">I")


class Action(Enum):
    """What a request sets going."""

    START = auto()
    STOP = auto()
    TRIGGER = auto()
    TEST_PACKET = auto()
    RESET = auto()


@dataclass(frozen=True, slots=True)
class ResendWanted:
    """A client misses packets of a frame, from first to last."""

    block: int
    first: int
    last: int


@dataclass(frozen=True, slots=True)
class AddressForced:
    """A client wants the camera to have another address, until its next start."""

    address: IPv4Address
    subnet: IPv4Address
    gateway: IPv4Address


Effect = Action | ResendWanted | AddressForced


@dataclass(frozen=True, slots=True)
class Reaction:
    """The answer's datagram, if there is one, and what is to happen."""

    answer: bytes | None = None
    effects: tuple[Effect, ...] = ()


class Control:
    """The registers of one camera and who may write them.  Times are of any monotonic clock, in seconds."""

    def __init__(self, device: Device, limits: SensorLimits, *, started_s: float = 0.0) -> None:
        self.device = device
        self.registers = Registers(device, limits, started_s=started_s)
        self.streaming = False
        self.controller: Address | None = None
        self._exclusive = False
        self._heard_s = 0.0

    @property
    def settings(self) -> StreamSettings:
        """Return what sensor and stream need, as it is now."""
        return self.registers.settings

    def expire(self, now_s: float) -> bool:
        """Take control from a client that has been silent for the heartbeat timeout; True if that happened."""
        if self.controller is None or now_s - self._heard_s < self.registers.heartbeat_s:
            return False
        self._release()
        return True

    def readdress(self, device: Device) -> None:
        """Live at another address from now on; whoever was in control is not any more."""
        self.device = device
        self._release()
        self.registers.introduce(device)

    def handle(self, datagram: bytes, source: Address, now_s: float, *, broadcast: bool = False) -> Reaction:
        """Return the reaction to a datagram of ``source``; what is not GVCP gets none."""
        try:
            request = decode_request(datagram)
        except GvcpError:
            return Reaction()
        self.expire(now_s)
        if broadcast and request.command not in (Command.DISCOVERY, Command.FORCE_IP):
            return Reaction()
        if source == self.controller:
            self._heard_s = now_s
        effects: list[Effect] = []
        try:
            body = self._dispatch(request, source, now_s, effects)
        except RefusedError as refused:
            body = refused
        if body is None or not request.needs_answer:
            return Reaction(None, tuple(effects))
        status, content = (body.status, b"") if isinstance(body, RefusedError) else (Status.SUCCESS, body)
        answer = Answer(status, (request.command + 1) & 0xFFFF, request.number, content)
        return Reaction(encode_answer(answer), tuple(effects))

    def _dispatch(self, request: Request, source: Address, now_s: float, effects: list[Effect]) -> bytes | None:
        body = request.body
        match request.command:
            case Command.DISCOVERY:
                return self.registers.introduction()
            case Command.FORCE_IP:
                return self._force_ip(body, effects)
            case Command.PACKET_RESEND:
                # Clients ask from the socket that the stream comes to, not from that of control.
                if self.controller is not None and source[0] == self.controller[0] and len(body) >= 12:
                    _channel, block, first, last = struct.unpack_from(">HHII", body)
                    effects.append(ResendWanted(block, first & 0xFF_FFFF, last & 0xFF_FFFF))
                return None
            case Command.READ_REGISTER:
                self._may_read(source)
                if not body or len(body) % 4 or len(body) > MAX_MEMORY_BYTES:
                    raise RefusedError(Status.INVALID_PARAMETER)
                return b"".join(
                    self.registers.read(_WORD.unpack_from(body, at)[0], 4, now_s) for at in range(0, len(body), 4)
                )
            case Command.READ_MEMORY:
                self._may_read(source)
                if len(body) < 8:
                    raise RefusedError(Status.INVALID_PARAMETER)
                address, count = struct.unpack_from(">IxxH", body)
                return body[:4] + self.registers.read(address, count, now_s)
            case Command.WRITE_REGISTER:
                if not body or len(body) % 8:
                    raise RefusedError(Status.INVALID_PARAMETER)
                for at in range(0, len(body), 8):
                    address, value = struct.unpack_from(">II", body, at)
                    self._write(address, value, source, now_s, effects)
                return struct.pack(">HH", 0, len(body) // 8)
            case Command.WRITE_MEMORY:
                return self._write_memory(body, source, now_s, effects)
            case _:
                raise RefusedError(Status.NOT_IMPLEMENTED)

    def _write_memory(self, body: bytes, source: Address, now_s: float, effects: list[Effect]) -> bytes:
        if len(body) < 8 or len(body) % 4:
            raise RefusedError(Status.INVALID_PARAMETER)
        (address,) = _WORD.unpack_from(body)
        data = body[4:]
        self._may_write(source)
        if address == Register.USER_NAME and len(data) <= 16:
            self.registers.write_user_name(data)
        else:
            for at in range(0, len(data), 4):
                self._write(address + at, _WORD.unpack_from(data, at)[0], source, now_s, effects)
        return struct.pack(">HH", 0, len(data))

    def _force_ip(self, body: bytes, effects: list[Effect]) -> bytes | None:
        if len(body) < 56 or body[2:8] != self.device.mac:
            return None  # another device is meant
        if self.controller is not None:
            raise RefusedError(Status.ACCESS_DENIED)
        address, subnet, gateway = (IPv4Address(body[at : at + 4]) for at in (20, 36, 52))
        if address not in LOOPBACK:
            raise RefusedError(Status.INVALID_PARAMETER)
        effects.append(AddressForced(address, subnet, gateway))
        return b""

    def _write(self, address: int, value: int, source: Address, now_s: float, effects: list[Effect]) -> None:
        if address == Register.CONTROL_PRIVILEGE:
            self._claim(value, source, now_s)
            return
        self._may_write(source)
        feature = self.registers.writable(address)
        if feature.locked and self.streaming:
            raise RefusedError(Status.BUSY)
        if feature.kind is Kind.COMMAND:
            self._execute(address, value, now_s, effects)
        elif address == Register.STREAM_PACKET_SIZE:
            self.registers.write_packet_size(value)
            if value & _FIRE:
                effects.append(Action.TEST_PACKET)
        else:
            self.registers.write(feature, value)

    def _execute(self, address: int, value: int, now_s: float, effects: list[Effect]) -> None:
        if address == Register.TIMESTAMP_CONTROL:
            if value & 1:
                self.registers.restart_clock(now_s)
            if value & 2:
                self.registers.latch(now_s)
            return
        action = {
            Place.ACQUISITION_START: Action.START,
            Place.ACQUISITION_STOP: Action.STOP,
            Place.TRIGGER_SOFTWARE: Action.TRIGGER,
            Place.DEVICE_RESET: Action.RESET,
        }[Place(address)]
        if action is Action.START:
            if not self.registers.word(Register.STREAM_PORT) & 0xFFFF:
                raise RefusedError(Status.INVALID_PARAMETER)
            self.streaming = True
        elif action is Action.STOP:
            self.streaming = False
        elif action is Action.RESET:
            self._release()
            self.registers.load_defaults()
        effects.append(action)

    def _claim(self, value: int, source: Address, now_s: float) -> None:
        if self.controller not in (None, source):
            raise RefusedError(Status.ACCESS_DENIED)
        wanted = value & (CCP_CONTROL | CCP_EXCLUSIVE)
        if not wanted:
            self._release()
            return
        self.controller = source
        self._exclusive = bool(wanted & CCP_EXCLUSIVE)
        self._heard_s = now_s
        self.registers.set_word(Register.CONTROL_PRIVILEGE, wanted)

    def _may_read(self, source: Address) -> None:
        if self._exclusive and source != self.controller:
            raise RefusedError(Status.ACCESS_DENIED)

    def _may_write(self, source: Address) -> None:
        if source != self.controller:
            raise RefusedError(Status.ACCESS_DENIED)

    def _release(self) -> None:
        self.controller = None
        self._exclusive = False
        self.streaming = False
        for register in (Register.CONTROL_PRIVILEGE, Register.STREAM_PORT, Register.STREAM_DESTINATION):
            self.registers.set_word(register, 0)
        self.registers.set_word(Place.PARAMETERS_LOCKED, 0)
