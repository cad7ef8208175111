"""How do the values of a telegram become bytes, and bytes its values?  By path, with the check sums; no socket.

Reading is tolerant in form (attributes in any order, ``/>`` or end tags, elements that EKI left out because they were
never set) and strict in content (numbers in range, our protocol version, no document type, no entities, bounded depth).
Writing is the plainest form that every EKI version reads: ASCII, explicit end tags, no declaration, three decimals.
What comes in that form is read with one regular expression, everything else by an XML parser.

Errors::

    TelegramError                 root
    ├── MalformedTelegramError    not XML, not the expected root, or damaged on its way
    └── InvalidTelegramError      XML, but a value is missing or out of range; knows session and sequence

A telegram with a value that cannot be read, or whose sums do not agree, was damaged on its way: it counts as malformed,
because nothing in it can be trusted.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any
from xml.parsers import expat

from slabcell_drivers.robot.eki.framing import MAX_TELEGRAM_BYTES
from slabcell_drivers.robot.eki.schema import (
    CHECK_NODE,
    EMPTY_TEXT,
    MAX_TEXT_CHARS,
    PROTOCOL_VERSION,
    ROBOT,
    VIS,
    Element,
    ElementType,
    Telegram,
)
from slabcell_drivers.robot.protocol import RequestType

__all__ = [
    "InvalidTelegramError",
    "MalformedTelegramError",
    "TelegramError",
    "Values",
    "read",
    "write",
]

SUM_TOLERANCE = 0.01
"""KRL adds with 24 bits of mantissa: twelve values of a metre, in mm, are off by less than a hundredth."""
MAX_DEPTH = 8
MAX_REAL = 1e9
MAX_NUMBER_CHARS = 40
MAX_INT = 2**31 - 1

_INT = re.compile(r"[+-]?[0-9]{1,10}", re.ASCII)
_REAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", re.ASCII)
_BOOL = {"1": 1, "0": 0, "true": 1, "false": 0}

Values = Mapping[str, Any]
"""By the path of each element: an int for INT and BOOL, a float for REAL, a str for STRING."""


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


# --------------------------------------------------------------------------------------------------------- both ways

_INTS, _REALS = f"{CHECK_NODE}/@Ints", f"{CHECK_NODE}/@Reals"


@dataclass(frozen=True, slots=True)
class _Kind:
    """How values of one type are written, how what is written so is read, and what one is that was never set."""

    written: str
    pattern: str
    read: Callable[[str], Any]
    unset: int | float | str


_KINDS = {
    ElementType.INT: _Kind("%d", "(-?[0-9]{1,9})", int, 0),
    ElementType.BOOL: _Kind("%d", "([01])", int, 0),
    ElementType.REAL: _Kind("%.3f", r"(-?[0-9]{1,8}\.[0-9]{1,6})", float, 0.0),
    ElementType.STRING: _Kind("%s", f"([ !#-%'-;=?-~]{{0,{MAX_TEXT_CHARS}}})", str.strip, EMPTY_TEXT),
}


class _Form:
    """What is known beforehand of the telegram of one direction."""

    def __init__(self, telegram: Telegram) -> None:
        elements = telegram.elements
        self.telegram = telegram
        self.paths = [element.path for element in elements]
        self.ints = [element.path for element in elements if element.type in {ElementType.INT, ElementType.BOOL}]
        self.reals = [element.path for element in elements if element.type is ElementType.REAL]
        self.summed_ints, self.summed_reals = telegram.summed(ElementType.INT), telegram.summed(ElementType.REAL)
        self.sums_reals = _REALS in self.paths
        self.unset: dict[str, Any] = {element.path: _KINDS[element.type].unset for element in elements}
        self.readers = [_KINDS[element.type].read for element in elements]
        self.written = _spell(telegram, lambda kind: kind.written, "></{}>")
        self.plain = re.compile(_spell(telegram, lambda kind: kind.pattern, "(?:/>|></{}>)"))


def _spell(telegram: Telegram, value: Callable[[_Kind], str], end: str) -> str:
    """Return a telegram as we write it, with ``value`` in the place of each value and ``end`` after each start tag."""
    parts = [f"<{telegram.root}>"]
    for node in telegram.nodes:
        attributes = [f' {item.attribute}="{value(_KINDS[item.type])}"' for item in node.elements if item.attribute]
        texts = [f">{value(_KINDS[item.type])}</{node.name}>" for item in node.elements if not item.attribute]
        parts += [f"<{node.name}", *attributes, *(texts or [end.format(node.name)])]
    return "".join([*parts, f"</{telegram.root}>"])


_FORMS = {item.root: _Form(item) for item in (ROBOT, VIS)}


def _rounded(form: _Form, values: Values) -> dict[str, Any]:
    """Return the values as they are on the wire: with three decimals, and never as -0."""
    return {**values, **{path: round(values[path], 3) + 0.0 for path in form.summed_reals}}


def _sums(form: _Form, rounded: Values) -> dict[str, Any]:
    """Return ``Check``: the sums over the values as they are on the wire."""
    sums: dict[str, Any] = {_INTS: sum([rounded[path] for path in form.summed_ints])}
    if form.sums_reals:
        sums[_REALS] = sum([rounded[path] for path in form.summed_reals])
    return sums


# ------------------------------------------------------------------------------------------------------------- writing


def write(telegram: Telegram, values: Values) -> bytes:
    """Return the telegram with these values, and their sums.  Raises InvalidTelegramError for one out of range."""
    form = _FORMS[telegram.root]
    own = _rounded(form, values)
    own |= _sums(form, own)
    for path in form.ints:
        if abs(own[path]) > MAX_INT:
            raise InvalidTelegramError(f"{path} = {own[path]}: KRL's INT ends at +-{MAX_INT}")
    for path in form.reals:
        if not abs(own[path]) <= MAX_REAL:  # nor is what is not a number
            raise InvalidTelegramError(f"{path} = {own[path]}: not a number between +-{MAX_REAL:g}")
    return (form.written % tuple([own[path] for path in form.paths])).encode("ascii")


# ------------------------------------------------------------------------------------------------------------- reading


def read(telegram: Telegram, raw: bytes, *, required: tuple[str, ...]) -> Values:
    """Return every value of a telegram; what EKI left out is 0, or the empty text.

    Raises MalformedTelegramError, and InvalidTelegramError where a required value is missing or the version is another.
    """
    form = _FORMS[telegram.root]
    plain = form.plain.fullmatch(raw.decode("latin-1"))
    if plain is not None:
        found = [reader(text) for reader, text in zip(form.readers, plain.groups(), strict=True)]
        values = dict(zip(form.paths, found, strict=True))
        if values["Head/@Ver"] == PROTOCOL_VERSION:
            _check_sums(form, values, values)
            return values
    return _read_xml(form, raw, required)


def _read_xml(form: _Form, raw: bytes, required: tuple[str, ...]) -> Values:
    """Return the values of any XML that means such a telegram."""
    telegram = form.telegram
    texts = _parse_xml(telegram.root, raw)
    said: dict[str, Any] = {}
    problems: list[str] = []
    for element in telegram.elements:
        text = texts.get(element.path)
        if text is None:
            continue
        try:
            said[element.path] = _value(element, text.strip())
        except ValueError as error:
            problems.append(str(error))
    values = {**form.unset, **said}
    version = said.get("Head/@Ver")
    if problems:
        raise MalformedTelegramError(f"{telegram.root} telegram: {problems[0]}")
    if version == PROTOCOL_VERSION:
        _check_sums(form, values, said)
    elif not _sums_up(texts):
        raise MalformedTelegramError(f"{telegram.root} telegram: Head/@Ver = {version}, and the sums do not agree")
    problems += [f"{path} is missing" for path in required if path not in texts]
    if version != PROTOCOL_VERSION:
        problems.insert(
            0, f"Head/@Ver = {version}: this side speaks version {PROTOCOL_VERSION}; install matching programs"
        )
    if problems:
        session, sequence = values["Head/@Ses"], values["Head/@Seq"]
        raise InvalidTelegramError(f"{telegram.root} telegram: {problems[0]}", session=session, sequence=sequence)
    return values


def _check_sums(form: _Form, values: Values, said: Values) -> None:
    """Compare the sums of all values with those that were said."""
    root = form.telegram.root
    if _INTS not in said and values["Head/@Type"] != RequestType.HEARTBEAT:
        raise MalformedTelegramError(f"{root} telegram: {CHECK_NODE}/@Ints is missing")
    rounded = _rounded(form, values) if form.sums_reals else values
    for path, expected in _sums(form, rounded).items():
        if path in said and abs(said[path] - expected) > SUM_TOLERANCE:
            raise MalformedTelegramError(f"{root}/{path} = {said[path]}, but the values add up to {expected}")


def _sums_up(texts: Mapping[str, str]) -> bool:
    """Whether a telegram of another version arrived as it was sent; its INTs are what is written like one."""
    ints = {path: int(text) for path, text in texts.items() if "@" in path and _INT.fullmatch(text.strip())}
    expected = ints.pop(_INTS, None)
    return expected == sum(ints.values())


def _value(element: Element, text: str) -> int | float | str:
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


def _parse_xml(root: str, raw: bytes) -> dict[str, str]:
    """Return the texts of any XML by path."""
    if len(raw) > MAX_TELEGRAM_BYTES:
        raise MalformedTelegramError(f"a telegram of {len(raw)} bytes; the limit is {MAX_TELEGRAM_BYTES}")
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
