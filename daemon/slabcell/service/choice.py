"""What was chosen last?  A small file of the state directory that names one thing."""

import json
from pathlib import Path
from typing import Final, cast

__all__ = ["read_choice"]

MAX_BYTES: Final = 64 << 10


def read_choice(path: Path, schema: str, key: str) -> str | None:
    """Return the name that a choice holds under its key, empty if the file is damaged; None if nothing was chosen.

    Raises OSError if it cannot be read.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES)
    except FileNotFoundError:
        return None
    try:
        document = cast("dict[str, object]", json.loads(raw))
        return str(document[key]) if document["schema"] == schema else ""
    except (ValueError, KeyError, TypeError):  # damaged: said by the caller, who knows whose file it is
        return ""
