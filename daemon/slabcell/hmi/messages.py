"""What does the daemon say, in the reader's language?  Its messages are English; pages show them in their own.

A language's folder has, for each English message with places for its values, the same in that language.  What stands
at a place may be a message of its own and is looked up too; ``{0:word}`` looks up a single word, which elsewhere may be
somebody's name.  Several messages may be said in one go, as lines or with semicolons or commas between them.  Where a
text can be read in more than one way, that counts in which the most of it is known.  What has no entry is shown as it
came: a daemon may be newer than the pages.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import islice
from pathlib import Path
from typing import Final

from slabcell.catalogue import catalogue

__all__ = ["load_messages", "load_words", "translate"]

ROOM: Final = Path(__file__).parent / "base"
MAX_LENGTH: Final = 2_000
"""Of a message that is looked up."""
MAX_DEPTH: Final = 6
"""Of messages inside of messages."""
MAX_TRIES: Final = 1_000
"""Of a message."""
MAX_READINGS: Final = 8
"""Of one template: its values may hold what stands between them."""
WORDS: Final = "words"
"""The table of single words."""
NOT_OURS: Final = ("libraries", "system", "shapes")
"""Tables of what pydantic and the operating system say, and of messages that are nothing but places."""
DECIMAL_COMMA: Final = frozenset({"de"})
"""Languages that write so the numbers of messages that have words; what a person wrote into a file stays as it is."""
_NUMBER: Final = re.compile(r"[+-]?\d+\.\d+")
_PLACE: Final = re.compile(r"\{(\d+)(:word)?\}")
_WORD: Final = re.compile(r"[A-Za-z]+")
_BETWEEN: Final = ("; ", ", ")
"""Between messages that are said in one line."""


@dataclass(frozen=True, slots=True)
class _Template:
    """An English message cut at its places, the numbers of these, and what it is in the other language."""

    literals: tuple[str, ...]
    places: tuple[str, ...]
    text: str
    comma: bool

    @property
    def says(self) -> int:
        """How much of a message it fixes."""
        return sum(map(len, self.literals))

    @property
    def key(self) -> str:
        """The longest word that a message needs to be this one; empty if there is none."""
        bare = _WORD.findall(" ".join(_inner(part, self.literals, at) for at, part in enumerate(self.literals)))
        return max(bare, key=len, default="")

    def readings(self, message: str) -> Iterator[dict[str, str]]:
        """Yield what may stand at the places; nothing if the message is another."""
        first, *rest = self.literals
        if not rest:
            if message == first:
                yield {}
        elif message.startswith(first) and message.endswith(rest[-1]) and len(message) >= len(first) + len(rest[-1]):
            for values in _cut(message[len(first) : len(message) - len(rest[-1])], rest[:-1]):
                yield dict(zip(self.places, values, strict=True))


def _inner(literal: str, literals: tuple[str, ...], at: int) -> str:
    """Return a literal without the letters that touch a place: a value's letters may go on there."""
    if at > 0:
        literal = literal.lstrip("".join(set(filter(str.isalpha, literal))))
    return literal if at == len(literals) - 1 else literal.rstrip("".join(set(filter(str.isalpha, literal))))


def _cut(text: str, between: list[str]) -> Iterator[tuple[str, ...]]:
    """Yield the ways of cutting a text at literals, the shortest pieces first."""
    if not between:
        yield (text,)
        return
    literal, *rest = between
    at = text.find(literal)
    while at >= 0:
        fits = False
        for values in _cut(text[at + len(literal) :], rest):
            fits = True
            yield (text[:at], *values)
        at = text.find(literal, at + 1) if literal and fits else -1


@cache
def _tables(language: str) -> dict[str, dict[str, str]]:
    tables: dict[str, dict[str, str]] = {}
    for path in sorted((ROOM / f"messages.{language}").glob("*.toml")):
        for name, entries in tomllib.loads(path.read_text(encoding="utf-8")).items():
            tables.setdefault(name, {}).update(entries)
    return tables


def load_messages(language: str, *, of_libraries: bool = False) -> dict[str, str]:
    """Return our messages in a language by the English ones; none in English.

    ``of_libraries``: those that are not ours instead, which reach people inside of our messages.
    """
    tables = _tables(language)
    named = (table for name, table in tables.items() if name != WORDS and (name in NOT_OURS) == of_libraries)
    return {english: text for table in named for english, text in table.items()}


def load_words(language: str) -> Mapping[str, str]:
    """Return the single words of a language by the English ones."""
    return _tables(language).get(WORDS, {})


def _of_catalogue(language: str) -> dict[str, str]:
    """Return what the error catalogue says, which stands in brackets behind what the daemon refuses."""
    path = ROOM / f"alarms.{language}.toml"
    if not path.exists():
        return {}
    words = tomllib.loads(path.read_text(encoding="utf-8"))
    return {
        english: words[str(number)][key]
        for number, entry in catalogue().items()
        for key, english in (("title", entry.title), ("meaning", entry.meaning), ("action", entry.action))
    }


@cache
def _templates(language: str) -> Mapping[str, tuple[_Template, ...]]:
    """Return every message by a word that it needs, those that say the most first."""
    known = load_messages(language) | load_messages(language, of_libraries=True) | _of_catalogue(language)
    by_key: dict[str, list[_Template]] = {}
    for english, text in known.items():
        parts = re.split(r"\{(\d+)\}", english)
        comma = language in DECIMAL_COMMA and text != english
        template = _Template(tuple(parts[::2]), tuple(parts[1::2]), text, comma)
        by_key.setdefault(template.key, []).append(template)
    return {key: tuple(sorted(found, key=lambda item: -item.says)) for key, found in by_key.items()}


@lru_cache(maxsize=4096)
def translate(language: str, message: str) -> str:
    """Return a message of the daemon in a language; unchanged as far as there is no such message."""
    if len(message) > MAX_LENGTH or not _templates(language):
        return message
    reader = _Reader(language)
    return "\n".join(reader.read(line, MAX_DEPTH).text for line in message.split("\n"))


@dataclass(frozen=True, slots=True)
class _Reading:
    """A way of reading a text: how much of it is known.

    Characters that are known, letters that are not, messages that it is made of; and what it says.
    """

    known: int
    unknown: int
    pieces: int
    text: str

    @property
    def worth(self) -> tuple[int, int]:
        """The more of it is known, and then the fewer pieces, the better."""
        return self.known, -self.pieces


class _Reader:
    """Reads one message; gives up on its rest when that has taken long, for values may be anything."""

    def __init__(self, language: str) -> None:
        self._templates = _templates(language)
        self._words = load_words(language)
        self._known: dict[str, _Reading] = {}
        self._tries = 0

    def read(self, text: str, depth: int) -> _Reading:
        """Return the best reading of a line, or of a part of it."""
        if text in self._known:
            return self._known[text]
        words = set(_WORD.findall(text))
        plain = _plain(text)
        if depth == 0 or not words or self._tries > MAX_TRIES:
            return plain
        self._known[text] = plain
        best = self._known[text] = max(self._readings(text, words, depth), key=lambda reading: reading.worth)
        return best

    def _readings(self, text: str, words: set[str], depth: int) -> list[_Reading]:
        """Return the ways of reading a text; one only if that leaves no letter unknown."""
        found = [_plain(text)]
        candidates = [template for word in ("", *words) for template in self._templates.get(word, ())]
        for template in sorted(candidates, key=lambda candidate: -candidate.says):
            for values in islice(template.readings(text), MAX_READINGS):
                self._tries += 1
                if self._tries > MAX_TRIES:
                    return found
                reading = self._filled(template, values, depth)
                if not reading.unknown:
                    return [reading]
                found.append(reading)
        found += (self._joined(text.split(joint), joint, depth) for joint in _BETWEEN if joint in text)
        return found

    def _filled(self, template: _Template, values: Mapping[str, str], depth: int) -> _Reading:
        known, unknown, pieces, text, at = template.says, 0, 1, "", 0
        for place in _PLACE.finditer(template.text):
            value = values[place[1]]
            word = self._words.get(value) if place[2] else None
            if template.comma and _NUMBER.fullmatch(value):
                word = value.replace(".", ",")
            found = self.read(value, depth - 1) if word is None else _Reading(len(value), 0, 0, word)
            known, unknown, pieces = known + found.known, unknown + found.unknown, pieces + found.pieces
            text, at = text + template.text[at : place.start()] + found.text, place.end()
        return _Reading(known, unknown, pieces, text + template.text[at:])

    def _joined(self, parts: list[str], joint: str, depth: int) -> _Reading:
        found = [self.read(part, depth - 1) for part in parts]
        known = sum(reading.known for reading in found)
        joints = len(joint) * (len(parts) - 1) if known else 0
        return _Reading(
            *(known + joints, sum(reading.unknown for reading in found), sum(reading.pieces for reading in found)),
            joint.join(reading.text for reading in found),
        )


def _plain(text: str) -> _Reading:
    return _Reading(0, sum(map(str.isalpha, text)), 0, text)
