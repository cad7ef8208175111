"""Where do log lines go?  One JSON object a line, with time and level, to a file."""

from pathlib import Path

import structlog

from slabcell.errors import SlabcellError

__all__ = ["log_to_file"]


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
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.StackInfoRenderer(),
            structlog.processors.dict_tracebacks,
            structlog.processors.JSONRenderer(default=repr),
        ],
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=structlog.WriteLoggerFactory(stream),
        cache_logger_on_first_use=False,
    )
