"""Where do log lines go?  One JSON object a line, with time and level, to a file, to a stream or to the journal.

What a line is about stands in fields of its own: ``job``, ``cycle``, ``result`` and the ``number`` of the error
catalogue.  A line that comes again and again is held back (`slabcell.log_rate`); its next appearance says how often.
Lines of libraries that use Python's own logging take the same way.
"""

import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TextIO

import structlog
import structlog.tracebacks
from structlog.typing import EventDict, Processor, WrappedLogger

from slabcell.errors import SlabcellError
from slabcell.journal import Journal, is_journal
from slabcell.log_rate import RateLimit

__all__ = ["JOURNAL_FIELDS", "log_to_file", "log_to_journal", "log_to_stream"]

_TRACEBACKS: Final = structlog.processors.ExceptionRenderer(
    structlog.tracebacks.ExceptionDictTransformer(show_locals=False)
)
"""Where a failure came from, without the values of variables: a password or a whole picture may be among them."""

_SYSTEMD_LEVELS: Final = {"critical": 2, "error": 3, "warning": 4, "info": 6, "debug": 7}

JOURNAL_FIELDS: Final = {
    "job": "SLABCELL_JOB",
    "cycle": "SLABCELL_CYCLE",
    "result": "SLABCELL_RESULT",
    "number": "SLABCELL_ERROR",
    "event": "SLABCELL_EVENT",
}
"""What of a line one can search the journal by: ``journalctl SLABCELL_JOB=17``."""


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

    A stream that systemd has connected to the journal is not written to: the lines go there with their fields.
    Source of the prefix: sd-daemon(3).
    """
    if stream.isatty():
        renderer = structlog.dev.ConsoleRenderer(exception_formatter=structlog.dev.plain_traceback)
        _configure(renderer, structlog.PrintLoggerFactory(stream))
        return
    journal = Journal.connect() if is_journal(stream.fileno()) else None
    if journal is not None:
        log_to_journal(journal, otherwise=stream)
        return
    _configure(_prefixed, structlog.WriteLoggerFactory(stream))


def log_to_journal(journal: Journal, *, otherwise: TextIO) -> None:
    """Send every later log line to the journal, with its fields.

    A line that the journal does not take goes to the stream ``otherwise``.
    """
    _configure(_identity, lambda *_: _ToJournal(journal, otherwise))


class _ToJournal:
    """A logger that structlog hands whole events."""

    def __init__(self, journal: Journal, otherwise: TextIO) -> None:
        self._journal = journal
        self._otherwise = otherwise

    def msg(self, **event: object) -> None:
        """Send one line."""
        line = json.dumps(event, default=repr)
        level = _SYSTEMD_LEVELS.get(str(event.get("level")), 6)
        fields = {"MESSAGE": line, "PRIORITY": str(level), "SYSLOG_IDENTIFIER": "slabcell"}
        fields |= {name: str(event[key]) for key, name in JOURNAL_FIELDS.items() if key in event}
        if not self._journal.send(fields):
            self._otherwise.write(f"<{level}>{line}\n")
            self._otherwise.flush()

    log = debug = info = warn = warning = error = critical = exception = fatal = failure = msg


def _identity(_: WrappedLogger, __: str, event: EventDict) -> EventDict:
    return event


def _prefixed(_: WrappedLogger, __: str, event: EventDict) -> str:
    level = _SYSTEMD_LEVELS.get(str(event.get("level")), 6)
    return f"<{level}>{json.dumps(event, default=repr)}"


class _FromLibraries(logging.Handler):
    """Takes lines of Python's own logging over."""

    def emit(self, record: logging.LogRecord) -> None:
        """Log the record as one of ours."""
        fields: dict[str, Any] = {"logger": record.name}
        if record.exc_info:
            fields["exc_info"] = record.exc_info
        structlog.stdlib.get_logger(record.name).log(record.levelno, record.getMessage(), **fields)


def _configure(renderer: Processor, factory: Callable[..., WrappedLogger]) -> None:
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            RateLimit(),
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.StackInfoRenderer(),
            *(() if isinstance(renderer, structlog.dev.ConsoleRenderer) else (_TRACEBACKS,)),
            _time_and_level_first,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger("info"),
        logger_factory=factory,
        cache_logger_on_first_use=False,
    )
    logging.basicConfig(level=logging.WARNING, handlers=[_FromLibraries()], force=True)
    logging.captureWarnings(capture=True)


def _time_and_level_first(_: WrappedLogger, __: str, event: EventDict) -> Mapping[str, object]:
    """Order a line as people read it."""
    first = {key: event[key] for key in ("timestamp", "level", "event") if key in event}
    return {**first, **event}
