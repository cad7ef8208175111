"""Which tokens does a KRL file consist of?  Bytes in, tokens with line and column out.

Files are latin-1 with CRLF on the controller; UTF-8 with and without BOM is taken as well, because editors save it.
FOLD lines are comments, and ``&`` lines are the header of the file: neither is part of the program.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from lark import Lark
from lark import Token as LarkToken

__all__ = ["MAX_SOURCE_BYTES", "Token", "decode", "tokenize"]

MAX_SOURCE_BYTES = 32 * 1024 * 1024

_SKIPPED = frozenset({"BLANK", "COMMENT", "HEADER"})
_WORDS = frozenset({"NAME", "ENUM"})


@dataclass(slots=True)
class Token:
    """One token: ``word`` is the text in capitals for names (KRL knows no case), the text itself otherwise."""

    kind: str
    text: str
    word: str
    line: int
    column: int


@cache
def _lexer() -> Lark:
    grammar = files("slabcell_drivers.krc").joinpath("grammar.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser=None, lexer="basic")


def decode(source: bytes) -> str:
    """Return the text of a KRL file, lines ended by a line feed."""
    if source.startswith(b"\xef\xbb\xbf"):
        text = source[3:].decode("utf-8", errors="replace")
    else:
        try:
            text = source.decode("utf-8")
        except UnicodeDecodeError:
            text = source.decode("latin-1")
    # NUL and Ctrl-Z are left behind by old editors and copies over serial lines.
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("\x00", " ").replace("\x1a", " ")


def tokenize(text: str) -> Iterator[Token]:
    """Yield the tokens of a program text, comments, blanks and header lines left out, and an END_OF_FILE at the end."""
    line = 1
    tokens: Iterator[LarkToken] = _lexer().lex(text)  # pyright: ignore[reportUnknownMemberType]  # untyped in lark
    for token in tokens:
        kind = token.type
        line = token.line or line
        if kind in _SKIPPED:
            continue
        value = str(token)
        word = value.upper() if kind in _WORDS else value
        yield Token(kind, value, word, line, token.column or 1)
    yield Token("END_OF_FILE", "", "", text.count("\n") + 1, 1)
