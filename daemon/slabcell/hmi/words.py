"""How does the HMI speak to a person?  In one table of words for each page and language.

A table is a TOML file beside the page's templates: ``en.toml``, ``de.toml``.  Its keys are the page's own; ``base`` is
there for all.  A word may hold places such as ``{slot}``.  A test holds the languages against each other.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final, cast

from slabcell.hmi.messages import translate

__all__ = ["LANGUAGES", "PageWords", "Words", "load_alarms", "load_tables"]

LANGUAGES: Final = {"en": "English", "de": "Deutsch"}
ROOM: Final = Path(__file__).parent
SAID: Final = frozenset(
    {"detail", "doing", "message", "note", "problem", "problems", "refusal", "segmentation", "title"}
)
"""Keys of the daemon's documents under which it speaks to people, one message or a list of them."""

Table = dict[str, str]


def load_tables(language: str) -> dict[str, Table]:
    """Return the tables of a language by the name of their page; nested keys are dotted."""
    found = {"base": ROOM / "base" / f"{language}.toml"}
    found |= {path.parent.name: path for path in sorted((ROOM / "pages").glob(f"*/{language}.toml"))}
    return {name: dict(_flat(tomllib.loads(path.read_text(encoding="utf-8")))) for name, path in found.items()}


def load_alarms(language: str) -> Table:
    """Return the error catalogue's words in a language; none in English, which the daemon speaks itself."""
    path = ROOM / "base" / f"alarms.{language}.toml"
    return dict(_flat(tomllib.loads(path.read_text(encoding="utf-8")), "alarm.")) if path.exists() else {}


def _flat(content: Mapping[str, Any], above: str = "") -> list[tuple[str, str]]:
    lines: list[tuple[str, str]] = []
    for name, value in content.items():
        lines += _flat(value, f"{above}{name}.") if isinstance(value, dict) else [(f"{above}{name}", str(value))]  # pyright: ignore[reportUnknownArgumentType]  (TOML)
    return lines


def _may_speak(item: object) -> bool:
    """Whether an entry of a list is more than the numbers that outlines and histograms are made of."""
    return isinstance(item, dict)


class Words:
    """The words of one language."""

    def __init__(self, language: str) -> None:
        self.language = language
        self._tables = load_tables(language)
        self._tables["base"] |= load_alarms(language)

    def of(self, page: str) -> PageWords:
        """Return the words of one page, and those of all."""
        return PageWords(self, page, {**self._tables["base"], **self._tables.get(page, {})})

    def number(self, value: float | None, digits: int = 1, unit: str = "", *, sign: bool = False) -> str:
        """Return a number with its unit; what was not measured is a dash."""
        if value is None or value != value:  # noqa: PLR0124 - only NaN differs from itself
            return "–"
        text = f"{value:{'+' if sign else ''}z.{digits}f}"
        if self.language == "de":
            text = text.replace(".", ",")
        text = text.replace("-", "−")
        return f"{text}\N{NO-BREAK SPACE}{unit}" if unit and unit != "°" else text + unit

    def duration(self, seconds: float) -> str:
        """Return a duration in two units at most."""
        whole = int(seconds)
        if seconds < 10:
            return self.number(seconds, 1, "s")
        if whole < 60:
            return f"{whole}\N{NO-BREAK SPACE}s"
        if whole < 3600:
            return f"{whole // 60}\N{NO-BREAK SPACE}min {whole % 60:02d}\N{NO-BREAK SPACE}s"
        if whole < 86_400:
            return f"{whole // 3600}\N{NO-BREAK SPACE}h {whole % 3600 // 60:02d}\N{NO-BREAK SPACE}min"
        day = "d" if self.language == "en" else "Tg."
        return f"{whole // 86_400}\N{NO-BREAK SPACE}{day} {whole % 86_400 // 3600}\N{NO-BREAK SPACE}h"

    def moment(self, utc: str | None) -> str:
        """Return a moment in the time zone of this computer, which stands beside the cell."""
        if not utc:
            return "–"
        local = datetime.fromisoformat(utc).astimezone()
        return local.strftime("%d.%m.%Y %H:%M:%S" if self.language == "de" else "%Y-%m-%d %H:%M:%S")


class PageWords:
    """The words that a page may use: ``w("title")``; ``w.maybe`` gives a default instead of failing."""

    def __init__(self, words: Words, page: str, table: Table) -> None:
        self.words, self.page, self._table = words, page, table
        self.language = words.language
        self.number, self.duration, self.moment = words.number, words.duration, words.moment

    def __call__(self, key: str, **values: object) -> str:
        """Return a word with its places filled in.  Raises KeyError: a page must not show what has no words."""
        try:
            text = self._table[key]
        except KeyError as error:
            msg = f"page {self.page}, language {self.language}: there is no word {key!r}"
            raise KeyError(msg) from error
        return text.format(**values) if values else text

    def said(self, message: str) -> str:
        """Return a message of the daemon in this language, as far as there are words for it."""
        return translate(self.language, message)

    def said_in(self, document: Any) -> Any:
        """Return a JSON value of the daemon with what it says to people in this language; the rest is as it is."""
        if self.language == "en":
            return document
        if isinstance(document, list):
            return [self.said_in(item) for item in document] if any(map(_may_speak, document)) else document  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]  (JSON)
        if not isinstance(document, dict):
            return document
        table = cast("dict[str, Any]", document)
        return {name: self._said(value) if name in SAID else self.said_in(value) for name, value in table.items()}

    def _said(self, value: Any) -> Any:
        if isinstance(value, list):
            return [self._said(item) for item in cast("list[Any]", value)]
        return self.said(value) if isinstance(value, str) else value

    def maybe(self, key: str, default: str) -> str:
        """Return a word, or what stands for it: for names that come from the daemon, which may be newer."""
        return self._table.get(key, default)
