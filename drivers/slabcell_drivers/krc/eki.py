"""What do the EKI functions of KRL do?  KUKA.EthernetKRL 2.2 to 3.2 in software, over real TCP.

Each function of KRL is a method here and returns an `EkiStatus`; what goes wrong is a message number in it, as on the
controller, never an exception.  Nothing runs by itself: `EthernetKrl.poll` takes what has arrived and sets the flags.
Only `open` of a client and `poll` with a timeout wait.

What the public documentation leaves open is decided in `slabcell_drivers.krc.unconfirmed`.
"""

import random
import selectors
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum

from slabcell_drivers.krc.eki_channel import Channel, Hooks, TelegramDirection, WireOptions
from slabcell_drivers.krc.eki_config import (
    FRAME_KEYS,
    EkiConfigError,
    ElementType,
    Environment,
    Role,
    parse_config,
)
from slabcell_drivers.krc.eki_memory import Entry, Value
from slabcell_drivers.krc.eki_messages import EKI_MESSAGE_TEXTS, EkiMessage
from slabcell_drivers.krc.eki_server import ServerSide
from slabcell_drivers.krc.eki_transport import Link, PlainLink, Transport, connect, listen
from slabcell_drivers.krc.eki_wire import send_paths, write_branch
from slabcell_drivers.robot.frame import Frame

__all__ = ["EkiEvent", "EkiStatus", "EthernetKrl"]

MAX_CHANNELS = 16
DEFAULT_CONNECT_TIMEOUT_S = 2.0
MAX_SENT_CHARS = 65536


@dataclass(frozen=True, slots=True)
class EkiStatus:
    """EKI_STATUS of KRL."""

    buff: int = 0
    read: int = 0
    msg_no: int = 0
    connected: bool = False
    counter: int = 0


class EkiEvent(Enum):
    """What ends channels, and the environments it ends."""

    PROGRAM_RESET = frozenset({Environment.PROGRAM})
    SUBMIT_CANCEL = frozenset({Environment.SUBMIT})
    IO_RECONFIGURE = frozenset(Environment)


def _no_telegram(_channel: str, _direction: TelegramDirection, _telegram: bytes) -> None:
    """Nobody watches the telegrams."""


def _no_notice(_channel: str, _text: str) -> None:
    """Nobody reads the notices."""


class EthernetKrl:
    """All channels of one controller.  Channel names are files, so their letter case does not matter.

    ``configs`` maps a channel's name to its configuration file; ``addresses`` replaces the address in it (of the
    external system for a client, the own one for a server).  ``link`` may put faults on each connection.
    """

    def __init__(
        self,
        configs: Mapping[str, bytes],
        *,
        set_flag: Callable[[int, bool], None],
        set_out: Callable[[int, bool], None],
        rng: random.Random,
        addresses: Mapping[str, tuple[str, int]] | None = None,
        wire: WireOptions | None = None,
        link: Link | None = None,
        on_telegram: Callable[[str, TelegramDirection, bytes], None] = _no_telegram,
        on_notice: Callable[[str, str], None] = _no_notice,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._files = {name.lower(): raw for name, raw in configs.items()}
        self._addresses = {name.lower(): address for name, address in (addresses or {}).items()}
        self._hooks = Hooks(set_flag, set_out, on_telegram, on_notice)
        self._wire = wire or WireOptions()
        self._link = link or PlainLink()
        self._rng = rng
        self._clock = clock
        self._channels: dict[str, Channel] = {}
        self._servers: dict[str, ServerSide] = {}
        self._ping_due: dict[str, float] = {}

    # ------------------------------------------------------------------------------------------------ life of a channel

    def init(self, channel: str) -> EkiStatus:
        """EKI_Init: read the configuration and reserve the memories."""
        key = channel.lower()
        if key in self._channels:
            return self._status(self._channels[key], EkiMessage.ALREADY_INITIALIZED)
        raw = self._files.get(key)
        if raw is None:
            self._hooks.notice(channel, f"there is no configuration file {channel}.xml")
            return EkiStatus(msg_no=EkiMessage.FILE_ACCESS_FAILED)
        try:
            config = parse_config(raw)
        except EkiConfigError as error:
            self._hooks.notice(channel, f"{channel}.xml: {error}")
            return EkiStatus(msg_no=EkiMessage.CONFIGURATION_INVALID if error.is_xml else EkiMessage.XML_INVALID)
        created = Channel(channel, config, self._hooks, wire=self._wire, rng=self._rng)
        self._channels[key] = created
        return self._status(created)

    def open(self, channel: str) -> EkiStatus:
        """EKI_Open: connect as client (waits, at most the configured time), or begin to listen as server."""
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        key = channel.lower()
        if found.connected or key in self._servers:
            return self._status(found)
        if sum(c.connected for c in self._channels.values()) + len(self._servers) >= MAX_CHANNELS:
            self._hooks.notice(channel, f"{MAX_CHANNELS} connections are active, no more are possible")
            return self._status(found, EkiMessage.NOT_ESTABLISHED)
        return self._listen(key, found) if found.config.role is Role.SERVER else self._connect(key, found)

    def _connect(self, key: str, channel: Channel) -> EkiStatus:
        address = self._addresses.get(key, (channel.config.external_ip, channel.config.external_port))
        if not self._link.reachable:
            self._hooks.notice(channel.name, f"no connection to {address[0]}:{address[1]}: the cable is cut")
            return self._status(channel, EkiMessage.NOT_ESTABLISHED)
        try:
            socket_transport = connect(address, self.connect_timeout_s(channel.name))
        except OSError as error:
            self._hooks.notice(channel.name, f"no connection to {address[0]}:{address[1]}: {error}")
            return self._status(channel, EkiMessage.NOT_ESTABLISHED)
        self._attach(key, channel, socket_transport)
        return self._status(channel)

    def _listen(self, key: str, channel: Channel) -> EkiStatus:
        address = self._addresses.get(key, (channel.config.internal_ip, channel.config.internal_port))
        try:
            listener = listen(address)
        except OSError as error:
            self._hooks.notice(channel.name, f"cannot listen on {address[0]}:{address[1]}: {error}")
            return self._status(channel, EkiMessage.SERVER_NOT_CREATED)
        timeout_s = channel.config.connect_timeout_s
        self._servers[key] = ServerSide(listener, None if timeout_s is None else self._clock() + timeout_s)
        return self._status(channel)

    def _attach(self, key: str, channel: Channel, transport: Transport) -> None:
        channel.attach(self._link.wrap(transport))
        if channel.config.ping_s is not None:
            self._ping_due[key] = self._clock() + channel.config.ping_s

    def close(self, channel: str) -> EkiStatus:
        """EKI_Close: end the connection; the memories stay."""
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        self._hang_up(channel.lower())
        return self._status(found)

    def clear(self, channel: str) -> EkiStatus:
        """EKI_Clear: end the connection and delete the channel with its memories."""
        key = channel.lower()
        if key not in self._channels:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        self._hang_up(key)
        del self._channels[key]
        return EkiStatus()

    def _hang_up(self, key: str) -> None:
        self._channels[key].detach()
        server = self._servers.pop(key, None)
        if server is not None:
            server.close()
        self._ping_due.pop(key, None)

    def end(self, event: EkiEvent) -> None:
        """Delete the channels whose environment ends with this event."""
        for key in [key for key, c in self._channels.items() if c.config.environment in event.value]:
            self.clear(key)

    def close_all(self) -> None:
        """Delete every channel; no socket is left open."""
        for key in list(self._channels):
            self.clear(key)

    @property
    def is_open(self) -> bool:
        """Tell whether anything can come: a channel has a connection, or listens for one."""
        return bool(self._servers) or any(channel.connected for channel in self._channels.values())

    def connect_timeout_s(self, channel: str) -> float:
        """Return how long `open` of this client waits at most; 2 s where the configuration does not say."""
        found = self._channels.get(channel.lower())
        configured = found.config.connect_timeout_s if found else None
        return DEFAULT_CONNECT_TIMEOUT_S if configured is None else configured

    # --------------------------------------------------------------------------------------------------------- sending

    def set_value(self, channel: str, path: str, value: Value) -> EkiStatus:
        """EKI_SetBool, SetInt, SetReal, SetString, SetFrame: the value stays until it is overwritten."""
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        tags = found.config.send
        six = [f"{path}/@{key}" for key in FRAME_KEYS]
        if isinstance(value, Frame) and all(tag in tags for tag in six):
            found.values.update(zip(six, map(float, value.as_tuple()), strict=True))
        elif path in tags:
            found.values[path] = value
        else:
            return self._status(found, EkiMessage.ELEMENT_NOT_FOUND)
        return self._status(found)

    def send(self, channel: str, path: str, length: int | None = None) -> EkiStatus:
        """EKI_Send: the configured branch at ``path``, or else ``path`` itself as it is, cut to ``length``.

        Text ends at its first NUL.
        """
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        if not found.connected:
            return self._status(found, EkiMessage.DISCONNECTED)
        if not found.config.send_raw and send_paths(found.config.send, path):
            shuffle = self._rng if self._wire.shuffle_attributes else None
            telegram = write_branch(found.config.send, path, found.values, shuffle=shuffle)
        else:
            text = path.split("\0", 1)[0][: MAX_SENT_CHARS if length is None else max(0, length)]
            telegram = text.encode("latin-1", "replace") if found.config.send_raw else text.encode()
        if not telegram:
            return self._status(found, EkiMessage.NOTHING_TO_SEND)
        if not found.send(telegram):
            return self._status(found, EkiMessage.SEND_FAILED)
        return self._status(found)

    # --------------------------------------------------------------------------------------------------------- reading

    def get_value(self, channel: str, path: str, kind: ElementType) -> tuple[EkiStatus, Value | None]:
        """EKI_GetBool, GetInt, GetReal, GetString, GetFrame: the next value, taken from its memory; None on failure."""
        status, values = self.get_array(channel, path, kind, 1)
        return status, values[0] if values else None

    def get_array(self, channel: str, path: str, kind: ElementType, count: int) -> tuple[EkiStatus, list[Value]]:
        """EKI_Get…Array: up to ``count`` values; the counter is 0 if they are not from one telegram."""
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE), []
        tags = found.memories.tags_of(path, kind)
        if tags is None:
            known = found.memories.known(path)
            return self._status(found, EkiMessage.TYPE_MISMATCH if known else EkiMessage.ELEMENT_NOT_FOUND), []
        part = ElementType.REAL if len(tags) > 1 else kind
        if any(not _reads_as(found.memories.type_of(tag), part) for tag in tags):
            return self._status(found, EkiMessage.TYPE_MISMATCH), []
        values: list[Value] = []
        telegrams: set[int] = set()
        for _ in range(count):
            entries = found.memories.take(tags)
            if entries is None:
                break
            values.append(_joined(entries))
            telegrams.update(entry.telegram for entry in entries)
        message = EkiMessage.NONE if values else EkiMessage.EMPTY_MEMORY
        counter = telegrams.pop() if len(telegrams) == 1 else 0
        return self._status(found, message, path=path, read=len(values), counter=counter), values

    def check_buffer(self, channel: str, path: str) -> EkiStatus:
        """EKI_CheckBuffer: how many values wait."""
        return self._on_memory(channel, path, clear=False)

    def clear_buffer(self, channel: str, path: str) -> EkiStatus:
        """EKI_ClearBuffer: empty the memory of an element, or of a node and all below it."""
        return self._on_memory(channel, path, clear=True)

    def _on_memory(self, channel: str, path: str, *, clear: bool) -> EkiStatus:
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        if not found.memories.known(path):
            return self._status(found, EkiMessage.ELEMENT_NOT_FOUND)
        if clear:
            found.memories.clear(path)
        return self._status(found, path=path)

    def lock(self, channel: str) -> EkiStatus:
        """EKI_Lock: what arrives from now on stays out of the memories."""
        return self._set_locked(channel, locked=True)

    def unlock(self, channel: str) -> EkiStatus:
        """EKI_Unlock: what has arrived meanwhile comes into the memories."""
        return self._set_locked(channel, locked=False)

    def _set_locked(self, channel: str, *, locked: bool) -> EkiStatus:
        found = self._channels.get(channel.lower())
        if found is None:
            return EkiStatus(msg_no=EkiMessage.CONNECTION_NOT_AVAILABLE)
        found.locked = locked
        found.interpret()
        return self._status(found)

    def check(self, status: EkiStatus, channel: str | None = None) -> tuple[int, str] | None:
        """EKI_CHECK: number and text of the message to show, or None.

        With a channel, what went wrong while receiving counts too, once.
        """
        number = status.msg_no
        found = self._channels.get(channel.lower()) if channel is not None else None
        if not number and found is not None:
            number, found.pending_message = int(found.pending_message), EkiMessage.NONE
        if not number:
            return None
        return number, f"EKI{number:05d} {EKI_MESSAGE_TEXTS[EkiMessage(number)]}"

    # --------------------------------------------------------------------------------------------------------- waiting

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Take what has arrived, waiting for something at most so long; return whether anything changed."""
        changed = self._take_all()
        if changed or timeout_s <= 0.0:
            return changed
        with selectors.DefaultSelector() as selector:
            for channel in self._channels.values():
                fd = channel.transport.readable_fd() if channel.transport is not None else None
                if fd is not None:
                    selector.register(fd, selectors.EVENT_READ)
            for server in self._servers.values():
                selector.register(server.listener, selectors.EVENT_READ)
            if not selector.get_map():
                time.sleep(timeout_s)
                return False
            selector.select(timeout_s)
        return self._take_all()

    def _take_all(self) -> bool:
        changed = False
        for key, server in list(self._servers.items()):
            changed |= self._serve(key, server)
        for key, channel in list(self._channels.items()):
            changed |= self._ping(key, channel)
            changed |= channel.poll()
            if not channel.connected and key in self._servers and self._servers[key].served:
                self._hang_up(key)  # restored only by EKI_Open
        return changed

    def _serve(self, key: str, server: ServerSide) -> bool:
        channel = self._channels[key]
        accepted = server.accept(refuse=channel.connected)
        if accepted is not None:
            self._attach(key, channel, accepted)
            return True
        if server.expired(self._clock()):
            self._hang_up(key)
            channel.pending_message = EkiMessage.SERVER_TIME_LIMIT
            self._hooks.notice(channel.name, "no client came within TIMEOUT")
            return True
        return False

    def _ping(self, key: str, channel: Channel) -> bool:
        due = self._ping_due.get(key)
        if due is None or channel.transport is None or self._clock() < due:
            return False
        if channel.transport.peer_answers_ping:
            self._ping_due[key] = self._clock() + (channel.config.ping_s or 1)
            return False
        channel.detach(EkiMessage.PING_FAILED, "the peer's host does not answer a ping")
        return True

    def _status(
        self,
        channel: Channel,
        message: EkiMessage = EkiMessage.NONE,
        *,
        path: str | None = None,
        read: int = 0,
        counter: int = 0,
    ) -> EkiStatus:
        buff = channel.memories.count(path) if path is not None else 0
        return EkiStatus(buff, read, int(message), channel.connected, counter)


def _reads_as(configured: ElementType | None, wanted: ElementType) -> bool:
    raw = configured in {ElementType.BYTE, ElementType.STREAM}
    return configured is wanted or (raw and wanted is ElementType.STRING)


def _joined(entries: tuple[Entry, ...]) -> Value:
    """Return the one value, or the frame that six of them make."""
    if len(entries) == 1:
        return entries[0].value
    x, y, z, a, b, c = (entry.value for entry in entries if isinstance(entry.value, float))
    return Frame(x, y, z, a, b, c)
