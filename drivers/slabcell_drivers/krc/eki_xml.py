"""How does XML from outside become a tree, and where does one document in a stream of bytes end?

Reading is bounded and refuses document types and entities; what is not well-formed raises `XmlError`.
"""

import re
from dataclasses import dataclass, field
from xml.parsers import expat

__all__ = ["DocumentSplitter", "XmlElement", "XmlError", "parse_document"]

MAX_DEPTH = 32
MAX_ELEMENTS = 20_000


class XmlError(ValueError):
    """Not well-formed XML within our bounds; the message names line and column."""


@dataclass(slots=True)
class XmlElement:
    """One element: its text is what stands between its children, joined."""

    name: str
    attributes: dict[str, str]
    line: int
    children: list["XmlElement"] = field(default_factory=list["XmlElement"])
    text: str = ""


def parse_document(raw: bytes) -> XmlElement:
    """Return the root element of one document.  Raises XmlError."""
    parser = expat.ParserCreate(namespace_separator=None)
    parser.buffer_text = True
    stack: list[XmlElement] = []
    roots: list[XmlElement] = []
    count = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(stack) >= MAX_DEPTH or count > MAX_ELEMENTS:
            raise XmlError(
                f"line {parser.CurrentLineNumber}: more than {MAX_DEPTH} levels or {MAX_ELEMENTS} elements of XML"
            )
        element = XmlElement(name, attributes, parser.CurrentLineNumber)
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def end(_name: str) -> None:
        stack.pop()

    def text(characters: str) -> None:
        if stack:
            stack[-1].text += characters

    def doctype(*_: object) -> None:
        raise XmlError(f"line {parser.CurrentLineNumber}: a document type is not allowed")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(raw, True)  # noqa: FBT003  the flag of a C function
    except expat.ExpatError as error:
        raise XmlError(f"line {error.lineno}, column {error.offset + 1}: {expat.ErrorString(error.code)}") from error
    except (ValueError, LookupError) as error:  # an unknown encoding, or a character that the declared one lacks
        if isinstance(error, XmlError):
            raise
        raise XmlError(f"not readable as XML: {error}") from error
    return roots[0]


_BETWEEN_DOCUMENTS = b" \t\r\n\0"
_TAG = re.compile(
    rb"<(?P<end>/)?(?P<name>[^!?<>/\s\"'][^<>/\s\"']*)(?:[^<>\"']|\"[^\"<]*\"|'[^'<]*')*>",
    re.DOTALL,
)
_PASSED_OVER = ((b"<!--", b"-->"), (b"<![CDATA[", b"]]>"), (b"<?", b"?>"), (b"<!", b">"))


class DocumentSplitter:
    """Cuts a stream into documents at the end tag of each root; a document may come in any number of pieces."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self._scanned = 0
        self._open: list[bytes] = []

    @property
    def pending_bytes(self) -> int:
        """How many bytes wait for the rest of their document."""
        return len(self._pending)

    def feed(self, data: bytes) -> list[bytes]:
        """Take the next bytes; return the documents that are now complete.

        Bytes between documents that begin no element are returned as a piece of their own, for the reader to refuse.
        """
        self._pending += data
        documents: list[bytes] = []
        while True:
            if self._scanned == 0:
                self._strip()
                junk = self._pending.find(b"<")
                if junk != 0:
                    end = len(self._pending) if junk < 0 else junk
                    if not end:
                        return documents
                    documents.append(self._take(end))
                    continue
            end = self._next_token()
            if end is None:
                return documents
            begin, self._scanned = self._scanned, end
            if self._closes_root(begin, end):
                documents.append(self._take(end))

    def _strip(self) -> None:
        del self._pending[: len(self._pending) - len(self._pending.lstrip(_BETWEEN_DOCUMENTS))]

    def _take(self, end: int) -> bytes:
        document = bytes(self._pending[:end])
        del self._pending[:end]
        self._scanned = 0
        self._open.clear()
        return document

    def _next_token(self) -> int | None:
        """Return where the next tag, comment or the like ends, and move to where it begins; None if it is not whole."""
        while True:
            begin = self._pending.find(b"<", self._scanned)
            if begin < 0:
                return None
            self._scanned = begin
            for opener, closer in _PASSED_OVER:
                if self._pending.startswith(opener, begin):
                    end = self._pending.find(closer, begin + len(opener))
                    return None if end < 0 else end + len(closer)
            tag = _TAG.match(self._pending, begin)
            if tag:
                return tag.end()
            following = self._pending.find(b"<", begin + 1)
            if following < 0:
                return None
            self._scanned = following  # what does not become a tag before the next one is garbage

    def _closes_root(self, begin: int, end: int) -> bool:
        """Follow the nesting; an end tag of the root's name ends the document even if something inside is open."""
        tag = _TAG.match(self._pending, begin, end)
        if tag is None:
            return False
        name = tag.group("name")
        if tag.group("end"):
            if self._open and name in {self._open[-1], self._open[0]}:
                del self._open[0 if name == self._open[0] and name != self._open[-1] else -1 :]
        elif not tag.group().endswith(b"/>"):
            self._open.append(name)
        return not self._open

    def clear(self) -> None:
        """Forget what is pending."""
        self._pending.clear()
        self._scanned = 0
        self._open.clear()
