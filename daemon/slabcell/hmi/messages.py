"""What does the daemon say, in the reader's language?  Its messages are English; pages show them in their own.

A language's file has, for each English message with places for its values, the same in that language.  What has no
entry is shown as it came: a daemon may be newer than the pages, and texts of libraries are nobody's to translate.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Final

__all__ = ["load_messages", "translate"]

ROOM: Final = Path(__file__).parent / "base"
MAX_LENGTH: Final = 2_000
"""Of a message that is looked up; patterns of several places take long on longer ones."""
_PLACE: Final = re.compile(r"\{(\d+)\}")


def load_messages(language: str) -> dict[str, str]:
    """Return the messages of a language by the English ones; none in English."""
    path = ROOM / f"messages.{language}.toml"
    if not path.exists():
        return {}
    tables: dict[str, dict[str, str]] = tomllib.loads(path.read_text(encoding="utf-8"))
    return {english: text for table in tables.values() for english, text in table.items()}


@cache
def _patterns(language: str) -> list[tuple[re.Pattern[str], str]]:
    """Return patterns with what stands for them, those that say the most first."""
    known = sorted(load_messages(language).items(), key=lambda item: -len(_PLACE.sub("", item[0])))
    return [(re.compile(_pattern(english), re.DOTALL), text) for english, text in known]


def _pattern(english: str) -> str:
    parts = _PLACE.split(english)
    return "".join(f"(?P<p{part}>.*?)" if index % 2 else re.escape(part) for index, part in enumerate(parts))


def translate(language: str, message: str) -> str:
    """Return a message of the daemon in a language; unchanged where there is no such message."""
    if len(message) > MAX_LENGTH:
        return message
    for pattern, text in _patterns(language):
        if found := pattern.fullmatch(message):
            return _PLACE.sub(lambda place: found[f"p{place[1]}"], text)
    return message
