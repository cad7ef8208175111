"""Which elements and flags does an EKI channel file configure?  A tolerant reader, for checks.

Element and attribute names are taken in any case, as controllers' own examples write them.  The software KRC has a
reader of its own that also refuses what a controller would refuse.
"""

from dataclasses import dataclass, field
from pathlib import PurePath
from xml.parsers import expat

__all__ = ["ChannelFile", "ChannelFileError", "ConfiguredElement", "read_channel_file"]

MAX_FILE_BYTES = 1 << 20


class ChannelFileError(ValueError):
    """The file is no well-formed XML; ``line`` counts from 1."""

    def __init__(self, message: str, line: int = 0) -> None:
        super().__init__(message)
        self.line = line


@dataclass(frozen=True, slots=True)
class ConfiguredElement:
    """One ELEMENT: its path, its type in upper case ("" where it has none), its flag (0 where it sets none)."""

    path: str
    type: str
    flag: int
    line: int


@dataclass(frozen=True, slots=True)
class ChannelFile:
    """One channel; its name is the file's without its ending."""

    file: str
    name: str
    received: tuple[ConfiguredElement, ...]
    sent: tuple[ConfiguredElement, ...]
    alive_flag: int


@dataclass
class _Reading:
    path: list[str] = field(default_factory=list[str])
    received: list[ConfiguredElement] = field(default_factory=list[ConfiguredElement])
    sent: list[ConfiguredElement] = field(default_factory=list[ConfiguredElement])
    alive_flag: int = 0
    root: str = ""


def read_channel_file(name: str, raw: bytes) -> ChannelFile | None:
    """Return the channel, or None if the XML file is none.  Raises ChannelFileError."""
    if len(raw) > MAX_FILE_BYTES:
        raise ChannelFileError(f"the file has {len(raw)} bytes; the limit is {MAX_FILE_BYTES}")
    reading = _Reading()
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        reading.path.append(tag.upper())
        reading.root = reading.root or tag.upper()
        values = {key.upper(): value for key, value in attributes.items()}
        if tag.upper() == "ALIVE":
            reading.alive_flag = _number(values.get("SET_FLAG", ""))
        if tag.upper() == "ELEMENT" and "TAG" in values:
            element = ConfiguredElement(
                values["TAG"],
                values.get("TYPE", "").upper(),
                _number(values.get("SET_FLAG", "")),
                parser.CurrentLineNumber,
            )
            if "RECEIVE" in reading.path:
                reading.received.append(element)
            elif "SEND" in reading.path:
                reading.sent.append(element)

    def end(_tag: str) -> None:
        reading.path.pop()

    def refuse(*_: object) -> None:
        raise ChannelFileError("a document type or an entity has no place in a channel file", parser.CurrentLineNumber)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(raw, True)  # noqa: FBT003 - expat's own signature: this is the final chunk
    except expat.ExpatError as error:
        raise ChannelFileError(f"not well-formed XML: {error}", error.lineno) from error
    except LookupError as error:
        raise ChannelFileError(f"not readable: {error}", 1) from error
    if reading.root != "ETHERNETKRL":
        return None
    return ChannelFile(name, PurePath(name).stem, tuple(reading.received), tuple(reading.sent), reading.alive_flag)


def _number(text: str) -> int:
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0
