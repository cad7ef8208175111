"""What does an EthernetKRL channel's configuration file say?  The classic XML of EKI 2.2 to 3.2, as values.

Names of elements and attributes are taken in any letter case, as KUKA's own examples mix them; values are checked
against the limits of the manual (KST EthernetKRL 2.2, pages 22 to 27), all problems of a file in one error.
"""

from dataclasses import dataclass
from enum import StrEnum

from slabcell_drivers.krc.eki_xml import XmlElement, XmlError, parse_document

__all__ = [
    "SERVER_PORTS",
    "Buffering",
    "ChannelConfig",
    "ConfigProblem",
    "EkiConfigError",
    "ElementType",
    "Environment",
    "ReceiveElement",
    "Role",
    "parse_config",
]

MAX_CONFIG_BYTES = 256 * 1024
SERVER_PORTS = range(54600, 54616)
FRAME_KEYS = ("X", "Y", "Z", "A", "B", "C")


@dataclass(frozen=True, slots=True)
class ConfigProblem:
    """One thing that is wrong with a configuration; ``line`` 0 is the whole file.

    ``is_ours``: a controller would take it, this software does not.
    """

    line: int
    text: str
    is_ours: bool = False

    def __str__(self) -> str:
        """Return the problem with its place."""
        return f"line {self.line}: {self.text}" if self.line else self.text


class EkiConfigError(ValueError):
    """A configuration that EKI would not take; ``problems`` lists everything that is wrong with it.

    ``is_xml`` tells whether the file is XML at all.
    """

    def __init__(self, problems: tuple[ConfigProblem, ...], *, is_xml: bool = True) -> None:
        super().__init__("; ".join(map(str, problems)))
        self.problems = problems
        self.is_xml = is_xml


class Role(StrEnum):
    """What the robot controller is: the opposite of the external system's TYPE."""

    CLIENT = "client"
    SERVER = "server"


class Environment(StrEnum):
    """Which interpreter a channel lives and ends with."""

    PROGRAM = "Program"
    SUBMIT = "Submit"
    SYSTEM = "System"


class Buffering(StrEnum):
    """Which entry of a memory is read first."""

    FIFO = "FIFO"
    LIFO = "LIFO"


class ElementType(StrEnum):
    """Type of a received element."""

    BOOL = "BOOL"
    INT = "INT"
    REAL = "REAL"
    STRING = "STRING"
    FRAME = "FRAME"
    BYTE = "BYTE"
    STREAM = "STREAM"


@dataclass(frozen=True, slots=True)
class ReceiveElement:
    """One configured element of what is received; without a type it only sets its flag and keeps nothing."""

    tag: str
    type: ElementType | None
    mode: Buffering
    set_flag: int | None = None
    set_out: int | None = None
    size: int = 0
    end_of_stream: tuple[bytes, ...] = ()


@dataclass(frozen=True, slots=True)
class ChannelConfig:
    """One channel.  ``external`` is the address of the external system, ``internal`` the controller's own."""

    role: Role = Role.CLIENT
    external_ip: str = ""
    external_port: int = 0
    internal_ip: str = ""
    internal_port: int = SERVER_PORTS.start
    environment: Environment = Environment.PROGRAM
    buffering: Buffering = Buffering.FIFO
    memory_limit: int = 16
    buffer_bytes: int = 16384
    connect_timeout_s: float | None = None
    alive_flag: int | None = None
    alive_out: int | None = None
    ping_s: int | None = None
    tcp: bool = True
    logging: str = "error"
    display: str = "error"
    receive: tuple[ReceiveElement, ...] = ()
    receive_raw: bool = False
    send: tuple[str, ...] = ()
    send_raw: bool = False


def parse_config(raw: bytes) -> ChannelConfig:
    """Return the channel that a configuration file describes.  Raises EkiConfigError."""
    if len(raw) > MAX_CONFIG_BYTES:
        raise EkiConfigError((ConfigProblem(0, f"{len(raw)} bytes; at most {MAX_CONFIG_BYTES} are read"),))
    try:
        root = parse_document(raw)
    except XmlError as error:
        raise EkiConfigError((ConfigProblem(0, str(error)),), is_xml=False) from error
    reader = _Reader()
    config = reader.read(root)
    if reader.problems:
        raise EkiConfigError(tuple(reader.problems))
    return config


class _Reader:
    """Reads one file and collects what is wrong with it."""

    def __init__(self) -> None:
        self.problems: list[ConfigProblem] = []

    def read(self, root: XmlElement) -> ChannelConfig:
        if root.name.upper() != "ETHERNETKRL":
            self._problem(root, f"root is <{root.name}>, not <ETHERNETKRL>")
            return ChannelConfig()
        configuration = self._section(root, "CONFIGURATION")
        external = self._section(configuration, "EXTERNAL")
        internal = _child(configuration, "INTERNAL") or XmlElement("INTERNAL", {}, configuration.line)
        role = Role.SERVER if self._choice(external, "TYPE", ("Server", "Client")) == "Client" else Role.CLIENT
        buffering = _child(internal, "BUFFERING")
        mode = self._mode(buffering, Buffering.FIFO)
        alive, messages = _child(internal, "ALIVE"), _child(internal, "MESSAGES")
        timeout_ms = self._attribute_number(_child(internal, "TIMEOUT"), "Connect", 0, 65534)
        receive_raw, receive = self._receive(_child(root, "RECEIVE"), mode)
        send_raw, send = self._send(_child(root, "SEND"))
        config = ChannelConfig(
            role=role,
            external_ip=_text(external, "IP"),
            external_port=self._element_number(external, "PORT", 1, 65534) or 0,
            internal_ip=_text(internal, "IP"),
            internal_port=self._element_number(internal, "PORT", 1, 65534) or SERVER_PORTS.start,
            environment=Environment(self._choice(internal, "ENVIRONMENT", tuple(Environment))),
            buffering=mode,
            memory_limit=self._attribute_number(buffering, "Limit", 1, 512) or 16,
            buffer_bytes=self._attribute_number(_child(internal, "BUFFSIZE"), "Limit", 1, 65534) or 16384,
            connect_timeout_s=None if timeout_ms is None else timeout_ms / 1000.0,
            alive_flag=self._attribute_number(alive, "Set_Flag", 1, 1024),
            alive_out=self._attribute_number(alive, "Set_Out", 1, 4096),
            ping_s=self._attribute_number(alive, "Ping", 1, 65534),
            tcp=self._choice(internal, "PROTOCOL", ("TCP", "UDP")) == "TCP",
            logging=_attribute(messages, "Logging") or "error",
            display=_attribute(messages, "Display") or "error",
            receive=receive,
            receive_raw=receive_raw,
            send=send,
            send_raw=send_raw,
        )
        self._check_role(config, external)
        return config

    def _check_role(self, config: ChannelConfig, external: XmlElement) -> None:
        if config.role is Role.CLIENT and not (config.external_ip and config.external_port):
            self._problem(external, "IP and PORT of the external system are needed, since it is the server")
        if not config.tcp:
            self._problem(external, "PROTOCOL UDP is not emulated", is_ours=True)

    def _receive(self, section: XmlElement | None, mode: Buffering) -> tuple[bool, tuple[ReceiveElement, ...]]:
        raw = _child(section, "RAW")
        container = raw or _child(section, "XML")
        elements = tuple(self._receive_element(e, mode, raw=raw is not None) for e in self._elements(container))
        tags = [element.tag for element in elements]
        for tag in sorted({tag for tag in tags if tags.count(tag) > 1}):
            self._problem(container, f"RECEIVE: tag {tag} is configured {tags.count(tag)} times")
        if raw is not None and len(elements) != 1:
            self._problem(raw, f"RAW has {len(elements)} elements; a channel has exactly one raw memory")
        return raw is not None, elements

    def _receive_element(self, element: XmlElement, mode: Buffering, *, raw: bool) -> ReceiveElement:
        kind = self._type(element, raw=raw)
        eos: tuple[bytes, ...] = ()
        if kind is ElementType.STREAM:
            eos = self._end_of_stream(element)
        size = self._attribute_number(element, "Size", 1, 3600) or 0
        if kind is ElementType.BYTE and not size:
            self._problem(element, "BYTE needs a Size from 1 to 3600")
        return ReceiveElement(
            tag=_attribute(element, "Tag") or "",
            type=kind,
            mode=self._mode(element, mode),
            set_flag=self._attribute_number(element, "Set_Flag", 1, 1024),
            set_out=self._attribute_number(element, "Set_Out", 1, 4096),
            size=size,
            end_of_stream=eos,
        )

    def _type(self, element: XmlElement, *, raw: bool) -> ElementType | None:
        text = _attribute(element, "Type")
        if text is None and not raw:
            return None
        allowed = (
            (ElementType.BYTE, ElementType.STREAM) if raw else [t for t in ElementType if t not in {"BYTE", "STREAM"}]
        )
        for kind in allowed:
            if text is not None and text.upper() == kind.value:
                return kind
        self._problem(element, f"Type {text!r} is not one of {', '.join(allowed)}")
        return None

    def _end_of_stream(self, element: XmlElement) -> tuple[bytes, ...]:
        """Return the endings of a stream: decimal codes, those of one ending by comma, endings by a bar."""
        text = _attribute(element, "EOS") or ""
        try:
            endings = tuple(bytes(int(code) for code in part.split(",")) for part in text.split("|"))
        except ValueError:
            self._problem(element, f"EOS {text!r} is not made of decimal codes from 0 to 255 such as 13,10")
            return ()
        return endings

    def _send(self, section: XmlElement | None) -> tuple[bool, tuple[str, ...]]:
        raw = _child(section, "RAW")
        container = raw or _child(section, "XML")
        tags = tuple(_attribute(element, "Tag") or "" for element in self._elements(container))
        for tag in sorted({tag for tag in tags if tags.count(tag) > 1}):
            self._problem(container, f"SEND: tag {tag} is configured {tags.count(tag)} times")
        return raw is not None, tags

    def _elements(self, container: XmlElement | None) -> list[XmlElement]:
        found: list[XmlElement] = []
        for element in container.children if container else []:
            if element.name.upper() != "ELEMENT":
                self._problem(element, f"<{element.name}> where <ELEMENT> is expected")
            elif not _attribute(element, "Tag"):
                self._problem(element, "an ELEMENT without Tag")
            else:
                found.append(element)
        return found

    def _section(self, parent: XmlElement, name: str) -> XmlElement:
        found = _child(parent, name)
        if found is None:
            self._problem(parent, f"<{name}> is missing")
            return XmlElement(name, {}, parent.line)
        return found

    def _mode(self, element: XmlElement | None, default: Buffering) -> Buffering:
        text = _attribute(element, "Mode")
        if text is None or element is None:
            return default
        if text.upper() not in {"FIFO", "LIFO"}:
            self._problem(element, f"Mode {text!r} is not FIFO or LIFO")
            return default
        return Buffering(text.upper())

    def _choice(self, parent: XmlElement, name: str, allowed: tuple[str, ...]) -> str:
        """Return the text of a child, in the spelling of ``allowed``, whose first is the default."""
        child = _child(parent, name)
        text = child.text.strip() if child else ""
        if child is None or not text:
            return str(allowed[0])
        for value in allowed:
            if text.upper() == value.upper():
                return str(value)
        self._problem(child, f"{name} {text!r} is not one of {', '.join(allowed)}")
        return str(allowed[0])

    def _element_number(self, parent: XmlElement, name: str, low: int, high: int) -> int | None:
        child = _child(parent, name)
        return self._number(child, name, child.text.strip() or None, low, high) if child else None

    def _attribute_number(self, element: XmlElement | None, name: str, low: int, high: int) -> int | None:
        return self._number(element, name, _attribute(element, name), low, high) if element else None

    def _number(self, element: XmlElement, name: str, text: str | None, low: int, high: int) -> int | None:
        if text is None:
            return None
        digits = text.strip()
        value = int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 9 else None
        if value is None or not low <= value <= high:
            self._problem(element, f"{name} {text!r} is not a whole number from {low} to {high}")
            return None
        return value

    def _problem(self, element: XmlElement | None, text: str, *, is_ours: bool = False) -> None:
        self.problems.append(ConfigProblem(element.line if element is not None else 0, text, is_ours))


def _child(parent: XmlElement | None, name: str) -> XmlElement | None:
    for child in parent.children if parent else []:
        if child.name.upper() == name:
            return child
    return None


def _text(parent: XmlElement, name: str) -> str:
    child = _child(parent, name)
    return child.text.strip() if child else ""


def _attribute(element: XmlElement | None, name: str) -> str | None:
    if element is None:
        return None
    return next((value for key, value in element.attributes.items() if key.upper() == name.upper()), None)
