"""How do verbs read and write the files that people name?"""

from pathlib import Path

from slabcell.errors import SlabcellError, UsageError

__all__ = ["read_file", "write_file"]


def read_file(path: Path) -> bytes:
    """Return what a file holds.  Raises UsageError."""
    try:
        return path.read_bytes()
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror}"
        raise UsageError(msg) from error


def write_file(path: Path, content: bytes) -> None:
    """Write a file, and the folder that it is in.  Raises SlabcellError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror}"
        raise SlabcellError(msg) from error
