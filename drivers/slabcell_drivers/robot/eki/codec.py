"""How does a telegram read and write?  Bytes to `Request` and `Answer` and back; pure, no socket.

Reading is tolerant in form (attributes in any order, ``/>`` or end tags, elements that EKI left out because they were
never set) and strict in content (numbers in range, known types and states, our protocol version, no document type,
no entities, bounded depth).  Writing is the plainest form that every EKI version reads: ASCII, explicit end tags, no
declaration, three decimals.

Errors::

    TelegramError                 root
    ├── MalformedTelegramError    not XML, not the expected root, or damaged on its way
    └── InvalidTelegramError      XML, but a value is missing or out of range; knows session and sequence

A telegram with a value that cannot be read, or whose sums do not agree, was damaged on its way: it counts as malformed,
because nothing in it can be trusted.
"""

import re
from collections.abc import Mapping
from xml.parsers import expat

from slabcell_drivers.robot.eki.framing import MAX_TELEGRAM_BYTES
from slabcell_drivers.robot.eki.schema import (
    CHECK_NODE,
    EMPTY_TEXT,
    HEARTBEAT_ROOT,
    MAX_TEXT_CHARS,
    PROTOCOL_VERSION,
    ROBOT,
    VIS,
    Element,
    ElementType,
    Telegram,
)
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.message import printable
from slabcell_drivers.robot.protocol import AckState, Answer, Offer, Request, RequestType, RobotStatus

__all__ = [
    "HEARTBEAT",
    "InvalidTelegramError",
    "MalformedTelegramError",
    "TelegramError",
    "decode_answer",
    "decode_request",
    "encode_answer",
    "encode_request",
]

SUM_TOLERANCE = 0.01
"""KRL adds with 24 bits of mantissa: twelve values of a metre, in mm, are off by less than a hundredth."""
MAX_DEPTH = 8
MAX_REAL = 1e9
MAX_NUMBER_CHARS = 40
MAX_INT = 2**31 - 1
HEARTBEAT = f"<{HEARTBEAT_ROOT}></{HEARTBEAT_ROOT}>".encode("ascii")
"""The cell's answer to a heartbeat: an element without a type, which only sets its flag and fills no memory."""

_PATHS = {item.root: tuple(element.path for element in item.elements) for item in (ROBOT, VIS)}
_INTS, _REALS = f"{CHECK_NODE}/@Ints", f"{CHECK_NODE}/@Reals"
_SUMMED = {item.root: (item.summed(ElementType.INT), item.summed(ElementType.REAL)) for item in (ROBOT, VIS)}
"""Paths of what is added up in each telegram."""

_INT = re.compile(r"[+-]?[0-9]{1,10}", re.ASCII)
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", re.ASCII)
_BOOL = {"1": 1, "0": 0, "true": 1, "false": 0}

Value = int | float | str


class TelegramError(ValueError):
    """A telegram that cannot be read or written."""


class MalformedTelegramError(TelegramError):
    """Not well-formed XML within our bounds, or not the expected root."""


class InvalidTelegramError(TelegramError):
    """A value is missing or out of range.  ``session`` and ``sequence`` are 0 where they could not be read."""

    def __init__(self, message: str, *, session: int = 0, sequence: int = 0) -> None:
        super().__init__(message)
        self.session = session
        self.sequence = sequence


def encode_request(request: Request) -> bytes:
    """Return the robot's telegram, as the KRC sends it."""
    status = request.status
    values: dict[str, Value] = {
        "Head/@Ver": PROTOCOL_VERSION,
        "Head/@Ses": request.session,
        "Head/@Seq": request.sequence,
        "Head/@Type": int(request.type),
        "Job/@Id": request.job_id,
        "Job/@Model": request.model,
        **_frame_values("Pose", request.tcp),
        **{f"Axis/@A{axis}": angle for axis, angle in enumerate(request.axes_deg, 1)},
        "Ack/@ResId": request.ack_result_id,
        "Ack/@State": int(request.ack_state),
        "Stat/@Mode": status.mode,
        "Stat/@Tool": status.tool,
        "Stat/@Base": status.base,
        "Stat/@Grip": int(status.gripper_holds_part),
        "Stat/@Err": status.error,
    }
    return _write(ROBOT, values)


def decode_request(telegram: bytes) -> Request:
    """Return what the robot asks.  Raises MalformedTelegramError or InvalidTelegramError."""
    values, session, sequence = _read_checked(ROBOT, telegram, required=("Head/@Seq", "Head/@Type"))
    try:
        type_, state = RequestType(_int(values, "Head/@Type")), AckState(_int(values, "Ack/@State"))
    except ValueError as error:
        raise InvalidTelegramError(f"Robot telegram: {error}", session=session, sequence=sequence) from error
    a1, a2, a3, a4, a5, a6 = (_real(values, f"Axis/@A{axis}") for axis in range(1, 7))
    return Request(
        type=type_,
        session=session,
        sequence=sequence,
        job_id=_int(values, "Job/@Id"),
        model=_int(values, "Job/@Model"),
        tcp=_frame(values, "Pose"),
        axes_deg=(a1, a2, a3, a4, a5, a6),
        ack_result_id=_int(values, "Ack/@ResId"),
        ack_state=state,
        status=RobotStatus(
            mode=_int(values, "Stat/@Mode"),
            tool=_int(values, "Stat/@Tool"),
            base=_int(values, "Stat/@Base"),
            gripper_holds_part=_int(values, "Stat/@Grip") != 0,
            error=_int(values, "Stat/@Err"),
        ),
    )


def encode_answer(answer: Answer) -> bytes:
    """Return the cell's telegram.  Text that is not printable ASCII is replaced, and cut at MAX_TEXT_CHARS."""
    offer = answer.offer or Offer(0, 0, 0, Frame(), Frame(), 0.0)
    values: dict[str, Value] = {
        "Head/@Ver": PROTOCOL_VERSION,
        "Head/@Ses": answer.session,
        "Head/@Seq": answer.sequence,
        "Head/@Ack": answer.acknowledges,
        "Res/@Code": int(answer.code),
        "Res/@ResId": offer.result_id,
        "Res/@Idx": offer.index,
        "Res/@Left": answer.left,
        "Res/@TrigSeq": answer.trigger_sequence,
        **_frame_values("Pick", offer.pick),
        **_frame_values("Place", offer.place),
        "Part/@Slot": offer.slot,
        "Part/@Score": offer.score,
        "Part/@Grip": offer.grip,
        "Msg": printable(answer.message) or EMPTY_TEXT,
    }
    return _write(VIS, values)


def decode_answer(telegram: bytes) -> Answer:
    """Return what the cell answers, as a robot reads it.  Raises MalformedTelegramError or InvalidTelegramError."""
    values, session, sequence = _read_checked(VIS, telegram, required=("Head/@Seq", "Head/@Ack", "Res/@Code"))
    result_id = _int(values, "Res/@ResId")
    offer = (
        Offer(
            result_id=result_id,
            index=_int(values, "Res/@Idx"),
            slot=_int(values, "Part/@Slot"),
            pick=_frame(values, "Pick"),
            place=_frame(values, "Place"),
            score=_real(values, "Part/@Score"),
            grip=_int(values, "Part/@Grip"),
        )
        if result_id
        else None
    )
    text = str(values.get("Msg", EMPTY_TEXT))
    return Answer(
        session=session,
        sequence=sequence,
        acknowledges=_int(values, "Head/@Ack"),
        code=_int(values, "Res/@Code"),
        left=_int(values, "Res/@Left"),
        trigger_sequence=_int(values, "Res/@TrigSeq"),
        offer=offer,
        message="" if text == EMPTY_TEXT else text,
    )


# ------------------------------------------------------------------------------------------------------------- writing


def _write(telegram: Telegram, values: Mapping[str, Value]) -> bytes:
    values = {**values, **_sums(telegram, values)}
    texts = [_text(element, values[element.path]) for element in telegram.elements]
    return (_FORMS[telegram.root] % tuple(texts)).encode("ascii")


def _form(telegram: Telegram, value: str, end: str) -> str:
    """Return a telegram as we write it, with ``value`` in the place of each value and ``end`` after each start tag."""
    parts = [f"<{telegram.root}>"]
    for node in telegram.nodes:
        attributes = "".join(f' {element.attribute}="{value}"' for element in node.elements if element.attribute)
        if all(element.attribute for element in node.elements):
            parts.append(f"<{node.name}{attributes}{end.format(node.name)}")
        else:
            parts.append(f"<{node.name}{attributes}>{value}</{node.name}>")
    parts.append(f"</{telegram.root}>")
    return "".join(parts)


_FORMS = {item.root: _form(item, "%s", "></{}>") for item in (ROBOT, VIS)}
_PLAIN = {item.root: re.compile(_form(item, "([ !#-%'-;=?-~]*)", "(?:/>|></{}>)")) for item in (ROBOT, VIS)}
"""What reads like a telegram of our own, printable and with nothing that XML would have to resolve."""


def _sums(telegram: Telegram, values: Mapping[str, Value]) -> dict[str, int | float]:
    """Return ``Check``: the sums over the values as they are on the wire, with three decimals."""
    ints, reals = _SUMMED[telegram.root]
    return {
        _INTS: sum([_int(values, path) for path in ints]),
        _REALS: sum([round(_real(values, path), 3) for path in reals]),
    }


def _text(element: Element, value: Value) -> str:
    kind = element.type
    if kind is ElementType.REAL:
        real = float(value)
        if not abs(real) <= MAX_REAL:  # nor is what is not a number
            raise InvalidTelegramError(f"{element.path} = {real}: not a number between +-{MAX_REAL:g}")
        return f"{real:.3f}" if abs(real) >= 0.0005 else "0.000"  # never "-0.000"
    if kind is ElementType.STRING:
        return str(value).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    number = int(value)
    if abs(number) > MAX_INT:
        raise InvalidTelegramError(f"{element.path} = {number}: KRL's INT ends at +-{MAX_INT}")
    return str(number)


def _frame_values(node: str, frame: Frame) -> dict[str, Value]:
    return {f"{node}/@{key}": value for key, value in zip("XYZABC", frame.as_tuple(), strict=True)}


# ------------------------------------------------------------------------------------------------------------- reading


def _int(values: Mapping[str, Value], path: str) -> int:
    return int(values.get(path, 0))


def _real(values: Mapping[str, Value], path: str) -> float:
    return float(values.get(path, 0.0))


def _frame(values: Mapping[str, Value], node: str) -> Frame:
    return Frame(*(_real(values, f"{node}/@{key}") for key in "XYZABC"))


def _read_checked(telegram: Telegram, raw: bytes, *, required: tuple[str, ...]) -> tuple[dict[str, Value], int, int]:
    """Return the typed values by path, session and sequence."""
    texts = _parse(telegram.root, raw)
    values: dict[str, Value] = {}
    problems: list[str] = []
    for element in telegram.elements:
        text = texts.get(element.path)
        if text is None:
            continue
        try:
            values[element.path] = _value(element, text.strip())
        except ValueError as error:
            problems.append(str(error))
    session, sequence = _int(values, "Head/@Ses"), _int(values, "Head/@Seq")
    version = values.get("Head/@Ver")
    if problems:
        raise MalformedTelegramError(f"{telegram.root} telegram: {problems[0]}")
    if version == PROTOCOL_VERSION:
        _check_sums(telegram, values)
    elif not _sums_up(texts):
        raise MalformedTelegramError(f"{telegram.root} telegram: Head/@Ver = {version}, and the sums do not agree")
    problems += [f"{path} is missing" for path in required if path not in texts]
    if version != PROTOCOL_VERSION:
        problems.insert(
            0, f"Head/@Ver = {version}: this side speaks version {PROTOCOL_VERSION}; install matching programs"
        )
    if problems:
        raise InvalidTelegramError(f"{telegram.root} telegram: {problems[0]}", session=session, sequence=sequence)
    return values, session, sequence


def _check_sums(telegram: Telegram, values: Mapping[str, Value]) -> None:
    if _INTS not in values and values.get("Head/@Type") != RequestType.HEARTBEAT:
        raise MalformedTelegramError(f"{telegram.root} telegram: {CHECK_NODE}/@Ints is missing")
    for path, expected in _sums(telegram, values).items():
        if path in values and abs(float(values[path]) - expected) > SUM_TOLERANCE:
            raise MalformedTelegramError(
                f"{telegram.root}/{path} = {values[path]}, but the values add up to {expected}"
            )


def _sums_up(texts: Mapping[str, str]) -> bool:
    """Whether a telegram of another version arrived as it was sent; its INTs are what is written like one."""
    ints = {path: int(text) for path, text in texts.items() if "@" in path and _INT.fullmatch(text.strip())}
    expected = ints.pop(_INTS, None)
    return expected == sum(ints.values())


def _value(element: Element, text: str) -> Value:
    kind = element.type
    if kind is ElementType.STRING:
        if len(text) > MAX_TEXT_CHARS:
            raise ValueError(f"{_shown(element, text)}…: {len(text)} characters; the limit is {MAX_TEXT_CHARS}")
        return text
    if len(text) > MAX_NUMBER_CHARS:
        raise ValueError(f"{_shown(element, text)}…: no number is that long")
    if kind is ElementType.REAL:
        if not _REAL.fullmatch(text) or abs(real := float(text)) > MAX_REAL:
            raise ValueError(f"{_shown(element, text)}: not a number between +-{MAX_REAL:g}")
        return real
    if kind is ElementType.BOOL and text.lower() in _BOOL:
        return _BOOL[text.lower()]
    if not _INT.fullmatch(text) or abs(number := int(text)) > MAX_INT:
        raise ValueError(f"{_shown(element, text)}: not a whole number between +-{MAX_INT}")
    return number


def _shown(element: Element, text: str) -> str:
    return f"{element.path} = {text[:MAX_NUMBER_CHARS]!r}"


class _Collector:
    """Expat's handlers: texts by path below the root."""

    def __init__(self, root: str) -> None:
        self.root = root
        self.path: list[str] = []
        self.texts: dict[str, str] = {}

    def start(self, name: str, attributes: dict[str, str]) -> None:
        if not self.path and name != self.root:
            raise MalformedTelegramError(f"the root is <{name[:20]}>, expected <{self.root}>")
        self.path.append(name)
        if len(self.path) > MAX_DEPTH:
            raise MalformedTelegramError(f"elements are nested deeper than {MAX_DEPTH}")
        here = "/".join(self.path[1:])
        if here in self.texts:
            raise MalformedTelegramError(f"<{here[:40]}> stands twice in one telegram")
        self.texts[here] = ""
        for attribute, value in attributes.items():
            self.texts[f"{here}/@{attribute}" if here else f"@{attribute}"] = value

    def end(self, _name: str) -> None:
        self.path.pop()

    def data(self, text: str) -> None:
        self.texts["/".join(self.path[1:])] += text

    def refuse(self, *_: object) -> None:
        raise MalformedTelegramError("a document type, an entity or a processing instruction: not accepted")


def _parse(root: str, raw: bytes) -> dict[str, str]:
    if len(raw) > MAX_TELEGRAM_BYTES:
        raise MalformedTelegramError(f"a telegram of {len(raw)} bytes; the limit is {MAX_TELEGRAM_BYTES}")
    plain = _PLAIN[root].fullmatch(raw.decode("latin-1"))
    if plain is not None:  # what both ends send: no need to ask an XML parser
        return dict(zip(_PATHS[root], plain.groups(), strict=True))
    return _parse_xml(root, raw)


def _parse_xml(root: str, raw: bytes) -> dict[str, str]:
    """Return the texts of any XML by path."""
    collector = _Collector(root)
    parser = expat.ParserCreate("US-ASCII")  # whatever a declaration says
    parser.buffer_text = True
    parser.StartElementHandler = collector.start
    parser.EndElementHandler = collector.end
    parser.CharacterDataHandler = collector.data
    parser.StartDoctypeDeclHandler = collector.refuse
    parser.EntityDeclHandler = collector.refuse
    parser.ProcessingInstructionHandler = collector.refuse
    try:
        parser.Parse(raw, True)  # noqa: FBT003 - expat's own signature: this is the final chunk
    except expat.ExpatError as error:
        raise MalformedTelegramError(f"not well-formed XML: {error}") from error
    except ValueError as error:
        if isinstance(error, TelegramError):
            raise
        raise MalformedTelegramError(f"not readable as XML: {error}") from error
    return collector.texts
