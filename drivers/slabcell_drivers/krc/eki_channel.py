"""What does one EthernetKRL channel do with what it receives, and what state is it in?

A channel keeps its memories after the connection is lost, until it is cleared.  Overflow of a memory closes the
connection at once, and the value that overflowed it can still be read.  Flags are set here and never reset, except the
one that says that the connection lives.
"""

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from slabcell_drivers.krc.eki_config import ChannelConfig, ElementType, ReceiveElement
from slabcell_drivers.krc.eki_memory import ElementMemories, Entry, Value
from slabcell_drivers.krc.eki_messages import EkiMessage
from slabcell_drivers.krc.eki_raw import RawSplitter
from slabcell_drivers.krc.eki_transport import LinkClosedError, Transport
from slabcell_drivers.krc.eki_wire import MAX_STRING_CHARS, read_value, received_elements
from slabcell_drivers.krc.eki_xml import DocumentSplitter, XmlError, parse_document

__all__ = ["Channel", "Hooks", "Segmentation", "TelegramDirection", "WireOptions"]


class TelegramDirection(StrEnum):
    """Which way a telegram went, seen from the controller."""

    SENT = "sent"
    RECEIVED = "received"


class Segmentation(StrEnum):
    """How telegrams are laid into TCP segments."""

    WHOLE = "whole"  # one send for each telegram
    SPLIT = "split"  # each telegram in several sends, cut at random
    MERGED = "merged"  # telegrams are kept and sent together at the next poll


@dataclass(frozen=True, slots=True)
class WireOptions:
    """Liberties that the documentation leaves to the controller, to be tried on a peer."""

    shuffle_attributes: bool = False
    segmentation: Segmentation = Segmentation.WHOLE


@dataclass(frozen=True, slots=True)
class Hooks:
    """What a channel tells the controller and whoever watches it."""

    set_flag: Callable[[int, bool], None]
    set_out: Callable[[int, bool], None]
    telegram: Callable[[str, TelegramDirection, bytes], None]
    notice: Callable[[str, str], None]


class Channel:
    """One initialised channel."""

    def __init__(
        self, name: str, config: ChannelConfig, hooks: Hooks, *, wire: WireOptions, rng: random.Random
    ) -> None:
        self.name = name
        self.config = config
        self.values: dict[str, Value] = {}
        self.memories = ElementMemories(config.receive, config.memory_limit)
        self.transport: Transport | None = None
        self.locked = False
        self.pending_message = EkiMessage.NONE
        """What went wrong while receiving, for the next EKI_CHECK with the channel's name."""
        self._hooks = hooks
        self._wire = wire
        self._rng = rng
        self._elements = {element.tag: element for element in config.receive}
        self._splitter = RawSplitter(config.receive[0]) if config.receive_raw else DocumentSplitter()
        self._uninterpreted: deque[bytes] = deque()
        self._kept: list[bytes] = []
        self._telegrams = 0

    @property
    def connected(self) -> bool:
        """Whether the connection is up."""
        return self.transport is not None

    # ------------------------------------------------------------------------------------------------------ connection

    def attach(self, transport: Transport) -> None:
        """Take a new connection: what was pending from an old one is forgotten, the memories stay."""
        self.transport = transport
        self._splitter.clear()
        self._uninterpreted.clear()
        self._kept.clear()
        self._alive(connected=True)

    def detach(self, message: EkiMessage = EkiMessage.NONE, reason: str = "") -> None:
        """Close the connection; ``message`` is kept for EKI_CHECK if it was not the program that closed it."""
        if self.transport is None:
            return
        self.transport.close()
        self.transport = None
        if message is not EkiMessage.NONE:
            self.pending_message = message
            self._hooks.notice(self.name, reason or message.name)
        self._alive(connected=False)

    def _alive(self, *, connected: bool) -> None:
        if self.config.alive_flag is not None:
            self._hooks.set_flag(self.config.alive_flag, connected)
        if self.config.alive_out is not None:
            self._hooks.set_out(self.config.alive_out, connected)

    # --------------------------------------------------------------------------------------------------------- sending

    def send(self, telegram: bytes) -> bool:
        """Send a telegram; return False, and close, if the connection is gone."""
        if self.transport is None:
            return False
        self._hooks.telegram(self.name, TelegramDirection.SENT, telegram)
        pieces = [telegram]
        if self._wire.segmentation is Segmentation.MERGED:
            self._kept.append(telegram)
            return True
        if self._wire.segmentation is Segmentation.SPLIT:
            pieces = self._cut(telegram)
        try:
            for piece in pieces:
                self.transport.send(piece)
        except LinkClosedError as error:
            self.detach(EkiMessage.CONNECTION_LOST, str(error))
            return False
        return True

    def _cut(self, telegram: bytes) -> list[bytes]:
        cuts = sorted({self._rng.randrange(len(telegram) + 1) for _ in range(self._rng.randint(1, 4))})
        return [telegram[a:b] for a, b in zip([0, *cuts], [*cuts, len(telegram)], strict=True) if a < b]

    # ------------------------------------------------------------------------------------------------------- receiving

    def poll(self) -> bool:
        """Send what was kept, take what has arrived; return whether anything changed."""
        if self.transport is None:
            return False
        try:
            if self._kept:
                glued = b"".join(self._kept)
                self._kept.clear()
                self.transport.send(glued)
            moved = self.transport.pump()
            data = self.transport.receive()
        except LinkClosedError as error:
            self.detach(EkiMessage.CONNECTION_LOST, str(error))
            return True
        if data:
            self._uninterpreted.extend(self._splitter.feed(data))
            if self._waiting_bytes() > self.config.buffer_bytes:
                text = f"more than {self.config.buffer_bytes} bytes wait to be interpreted (BUFFSIZE)"
                self.detach(EkiMessage.BUFFER_LIMIT, text)
            self.interpret()
        return moved or bool(data)

    def _waiting_bytes(self) -> int:
        """Return how many bytes nobody interprets: an unfinished telegram, and all of them while locked."""
        held = sum(len(telegram) for telegram in self._uninterpreted) if self.locked else 0
        return held + self._splitter.pending_bytes

    def interpret(self) -> None:
        """Bring the telegrams that have arrived into the memories, unless locked."""
        while self._uninterpreted and not self.locked:
            telegram = self._uninterpreted.popleft()
            self._hooks.telegram(self.name, TelegramDirection.RECEIVED, telegram)
            self._telegrams += 1
            if self.config.receive_raw:
                self._store(self.config.receive[0], telegram.decode("latin-1"))
                self._signal(self.config.receive[0])
            else:
                self._interpret_xml(telegram)

    def _interpret_xml(self, telegram: bytes) -> None:
        try:
            root = parse_document(telegram)
        except XmlError as error:
            self._refuse(EkiMessage.RECEIVED_XML_INVALID, f"received XML is invalid: {error}")
            return
        arrived: list[ReceiveElement] = []
        unknown: list[str] = []
        for received in received_elements(root):
            element = self._elements.get(received.path)
            if element is None:
                unknown.append(received.path)
                continue
            if element.type is not None:
                try:
                    value = read_value(received, element.type)
                except ValueError as error:
                    too_long = element.type is ElementType.STRING and len(received.text) > MAX_STRING_CHARS
                    number = EkiMessage.STRING_TOO_LONG if too_long else EkiMessage.RECEIVED_XML_INVALID
                    self._refuse(number, str(error))
                    continue
                self._store(element, value)
            arrived.append(element)
        self._note_unknown(unknown)
        # only now, with the whole telegram in the memories, may the program see it
        for element in arrived:
            self._signal(element)

    def _store(self, element: ReceiveElement, value: Value) -> None:
        if not self.memories.store(element.tag, Entry(value, self._telegrams)):
            text = f"memory of {element.tag} holds more than {self.config.memory_limit} values (BUFFERING Limit)"
            self.detach(EkiMessage.MEMORY_LIMIT, text)

    def _signal(self, element: ReceiveElement) -> None:
        if element.set_flag is not None:
            self._hooks.set_flag(element.set_flag, True)  # noqa: FBT003  a flag's value
        if element.set_out is not None:
            self._hooks.set_out(element.set_out, True)  # noqa: FBT003  an output's value

    def _note_unknown(self, paths: list[str]) -> None:
        configured = [path for path in paths if not self.memories.known(path)]
        if configured:
            self._hooks.notice(self.name, f"received but not configured: {', '.join(configured[:5])}")

    def _refuse(self, message: EkiMessage, reason: str) -> None:
        self.pending_message = message
        self._hooks.notice(self.name, reason)
