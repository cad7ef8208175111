"""Where do log lines go?  One JSON object a line, with time and level, to a file or to the journal."""

from collections.abc import Callable
from pathlib import Path
from typing import Final, TextIO

import structlog
from structlog.typing import EventDict, Processor, WrappedLogger

from slabcell.errors import SlabcellError

__all__ = ["log_to_file", "log_to_stream"]

_SYSTEMD_LEVELS: Final = {"critical": 2, "error": 3, "warning": 4, "info": 6, "debug": 7}


def log_to_file(path: Path) -> None:
    """Send every later log line of the process to a new file at ``path``.  Raises SlabcellError.

    The file stays open for the life of the process, and each line is flushed: what was logged before a crash is there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream = path.open("w", encoding="utf-8")
    except OSError as error:
        msg = f"{path}: the log cannot be written: {error.strerror}; choose another folder"
        raise SlabcellError(msg) from error
    _configure(structlog.processors.JSONRenderer(default=repr), structlog.WriteLoggerFactory(stream))


def log_to_stream(stream: TextIO) -> None:
    """Send every later log line to a stream: in colour to a terminal, else as JSON with systemd's level prefix.

    Source of the prefix: sd-daemon(3).
    """
    if stream.isatty():
        _configure(structlog.dev.ConsoleRenderer(), structlog.PrintLoggerFactory(stream))
        return
    render = structlog.processors.JSONRenderer(default=repr)

    def prefixed(logger: WrappedLogger, method: str, event: EventDict) -> str:
        level = _SYSTEMD_LEVELS.get(str(event.get("level")), 6)
        return f"<{level}>{render(logger, method, event)}"

    _configure(prefixed, structlog.WriteLoggerFactory(stream))


def _configure(renderer: Processor, factory: Callable[..., WrappedLogger]) -> None:
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.StackInfoRenderer(),
            structlog.processors.dict_tracebacks,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=factory,
        cache_logger_on_first_use=False,
    )
