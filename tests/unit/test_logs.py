"""What does a log line hold, where does it go, and how often?"""

import contextlib
import io
import json
import logging
import os
import socket
import subprocess
import sys

import pytest
import structlog

from slabcell.journal import Journal, is_journal
from slabcell.log_rate import MAX_KINDS, RateLimit
from slabcell.logs import log_to_journal, log_to_stream

pytestmark = pytest.mark.unit


@pytest.fixture(autouse=True)
def logging_as_before():
    handlers, level = logging.root.handlers[:], logging.root.level
    yield
    structlog.reset_defaults()
    logging.captureWarnings(capture=False)
    logging.root.handlers[:] = handlers
    logging.root.setLevel(level)


@pytest.fixture
def journal(tmp_path):
    """What stands in for the journal, and the stream for what it does not take."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(tmp_path / "journal"))
        server.settimeout(10)
        connected = Journal.connect(tmp_path / "journal")
        stream = io.StringIO()
        log_to_journal(connected, otherwise=stream)
        yield server, stream
        connected.close()


def fields(datagram: bytes) -> dict[str, str]:
    """Read the native protocol."""
    found = {}
    while datagram:
        line, _, rest = datagram.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if not equals:
            length = int.from_bytes(rest[:8], "little")
            value, rest = rest[8 : 8 + length], rest[8 + length + 1 :]
        found[name.decode()], datagram = value.decode(), rest
    return found


def test_the_journal_gets_the_line_its_priority_and_fields_to_search_by(journal):
    server, _ = journal
    log = structlog.get_logger("slabcell.alarm")
    with structlog.contextvars.bound_contextvars(job=17, cycle=4):
        log.warning("alarm came", number=1101, detail="two\nlines")
    entry = fields(server.recv(100_000))
    line = json.loads(entry.pop("MESSAGE"))
    assert (line["level"], line["event"], line["detail"], line["job"]) == ("warning", "alarm came", "two\nlines", 17)
    assert entry == {
        "PRIORITY": "4",
        "SYSLOG_IDENTIFIER": "slabcell",
        "SLABCELL_JOB": "17",
        "SLABCELL_CYCLE": "4",
        "SLABCELL_ERROR": "1101",
        "SLABCELL_EVENT": "alarm came",
    }


def test_an_error_s_traceback_is_in_the_line_and_a_line_that_is_too_long_loses_its_end(journal):
    server, _ = journal
    log = structlog.get_logger()
    try:
        json.loads("no JSON")
    except ValueError:
        log.exception("failed")
    assert json.loads(fields(server.recv(100_000))["MESSAGE"])["exception"][0]["exc_type"] == "JSONDecodeError"
    log.info("long", words="ü" * 100_000)
    assert 50_000 < len(server.recv(200_000)) <= 60_000


def test_a_traceback_holds_no_values_of_variables(journal, monkeypatch):
    server, _ = journal

    def log_in(password):
        raise RuntimeError(len(password))

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal, secret = Terminal(), "let me in"
    for read in (lambda: server.recv(100_000).decode(), terminal.getvalue):
        try:
            log_in(secret)
        except RuntimeError:
            structlog.get_logger().exception("failed")
        written = read()
        assert "log_in" in written
        assert "let me in" not in written
        log_to_stream(terminal)


def test_what_the_journal_does_not_take_goes_to_the_stream(journal):
    server, stream = journal
    server.close()
    structlog.get_logger().error("unheard")
    level, line = stream.getvalue()[:3], json.loads(stream.getvalue()[3:])
    assert (level, line["event"]) == ("<3>", "unheard")


def test_without_a_journal_a_line_is_json_with_its_level_before_it(tmp_path):
    assert Journal.connect(tmp_path / "nothing") is None
    script = (
        "import sys, structlog\nfrom slabcell.logs import log_to_stream\nlog_to_stream(sys.stderr)\n"
        "structlog.get_logger().warning('here', cycle=3)\nimport logging\nlogging.getLogger('uvicorn').error('there')\n"
    )
    environment = {key: value for key, value in os.environ.items() if key != "JOURNAL_STREAM"}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, env=environment)
    ours, theirs = done.stderr.splitlines()
    assert ours.startswith('<4>{"timestamp": ')
    assert json.loads(ours[3:])["cycle"] == 3
    assert theirs.startswith("<3>")
    assert json.loads(theirs[3:])["logger"] == "uvicorn"


def test_a_stream_that_systemd_connected_to_the_journal_is_known_by_its_inode(monkeypatch, tmp_path):
    with (tmp_path / "log").open("w") as stream:
        status = os.fstat(stream.fileno())
        assert not is_journal(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino}")
        assert is_journal(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{status.st_dev}:{status.st_ino + 1}")
        assert not is_journal(stream.fileno())


def test_a_terminal_gets_readable_lines(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    log_to_stream(terminal)
    structlog.get_logger().info("state", before="ready", after="halted")
    assert "state" in terminal.getvalue()
    assert not terminal.getvalue().startswith(("{", "<"))


def test_a_line_that_repeats_itself_is_held_back_and_the_next_says_how_often(tmp_path):
    now = [0.0]
    limit = RateLimit(burst=3, per_second=1.0, clock=lambda: now[0])
    kept = []
    for index in range(10):
        with contextlib.suppress(structlog.DropEvent):
            kept.append(limit(None, "", {"event": "camera not open", "level": "warning", "try": index}))
        if index == 8:
            now[0] += 1.5
    assert [line["try"] for line in kept] == [0, 1, 2, 9]
    assert kept[-1]["held_back"] == 6
    # Other lines are not concerned, and what ends the process is never held back.
    assert limit(None, "", {"event": "state", "level": "info"}) == {"event": "state", "level": "info"}
    assert all(limit(None, "", {"event": "end", "level": "critical"}) for _ in range(10))


def test_the_kinds_of_lines_that_are_remembered_are_bounded():
    limit = RateLimit()
    for index in range(3 * MAX_KINDS):
        limit(None, "", {"event": f"event {index}", "level": "info"})
    assert len(limit._buckets) == MAX_KINDS


def test_a_file_holds_one_json_object_a_line(tmp_path):
    script = (
        "import sys, pathlib, structlog\nfrom slabcell.logs import log_to_file\n"
        "log_to_file(pathlib.Path(sys.argv[1]))\n"
        "structlog.get_logger().info('one', number=1703)\nstructlog.get_logger().info('two')\n"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "deep" / "log")], check=True)
    lines = (tmp_path / "deep" / "log").read_text().splitlines()
    assert [json.loads(line)["event"] for line in lines] == ["one", "two"]
