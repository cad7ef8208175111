"""How does a program ask the running daemon?  A plain, blocking client of the control API on its Unix socket.

It needs nothing but the standard library, so that commands start at once.  Errors come as those of the house: no daemon
is `UnavailableError`, no right to the socket `NotPermittedError`, what can be tried again `TemporaryError`.
"""

from __future__ import annotations

import http.client
import json
import os
import socket
import time
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast
from urllib.parse import urlencode

from slabcell.errors import NotPermittedError, SlabcellError, TemporaryError, UnavailableError
from slabcell.service.api.person import PERSON_HEADER

__all__ = ["DEFAULT_SOCKET", "Answer", "ApiClient", "ApiEvent", "default_socket"]

DEFAULT_SOCKET: Final = Path("/run/slabcell/api.sock")
MAX_ANSWER_BYTES: Final = 256 << 20
MAX_LINE_BYTES: Final = 4 << 20
SILENCE_S: Final = 30.0
"""A stream of events says something every ten seconds; silence this long is a daemon that hangs."""

Json = dict[str, Any]


def default_socket() -> Path:
    """Return the socket that is meant when none is named: SLABCELL_SOCKET, or the service's."""
    return Path(os.environ.get("SLABCELL_SOCKET") or DEFAULT_SOCKET)


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back: content, its media type, and its ETag where it has one."""

    content: bytes
    media_type: str
    etag: str = ""


@dataclass(frozen=True, slots=True)
class ApiEvent:
    """One event of the stream."""

    id: str
    kind: str
    data: Json


class _Connection(http.client.HTTPConnection):
    def __init__(self, path: Path, timeout_s: float) -> None:
        super().__init__("localhost", timeout=timeout_s)
        self._path = path

    def connect(self) -> None:
        """Connect to the socket."""
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        try:
            self.sock.connect(os.fspath(self._path))
        except BaseException:
            self.sock.close()
            raise


class ApiClient:
    """Asks the daemon at one socket; each request has a connection of its own.

    ``on_behalf_of`` names the person for whom a program asks; the daemon's records then name both.
    """

    def __init__(self, path: Path | None = None, *, timeout_s: float = 30.0, on_behalf_of: str = "") -> None:
        self.path = path or default_socket()
        self._timeout_s = timeout_s
        self._on_behalf_of = on_behalf_of

    def get(self, path: str, **query: str | float | bool) -> Json:
        """Return the JSON object of a resource.  Raises SlabcellError."""
        return _object(self.fetch(path, **query))

    def fetch(self, path: str, **query: str | float | bool) -> Answer:
        """Return a resource of any kind.  Raises SlabcellError."""
        words = {name: str(value).lower() if isinstance(value, bool) else value for name, value in query.items()}
        return self._ask("GET", f"{path}?{urlencode(words)}" if words else path, None, {})

    def post(self, path: str, body: Json | None = None, *, key: str | None = None) -> Json:
        """Have something done, once; return the JSON object of the answer.  Raises SlabcellError."""
        content = None if body is None else json.dumps(body).encode()
        return self.send(path, content, "application/json", key=key)

    def send(self, path: str, content: bytes | None, media_type: str, *, key: str | None = None) -> Json:
        """Have something done with content of another type."""
        headers = {"Idempotency-Key": key or str(uuid.uuid4())}
        if self._on_behalf_of:
            headers[PERSON_HEADER] = self._on_behalf_of
        if content is not None:
            headers["Content-Type"] = media_type
        return _object(self._ask("POST", path, content, headers))

    def follow(self, task: Json) -> Json:
        """Wait for a task of the daemon (a ``slabcell.task/1`` object); return what came of it.

        Raises SlabcellError if it failed or was cancelled.
        """
        pause_s = 0.05
        while task["state"] == "running":
            time.sleep(pause_s)
            pause_s = min(1.0, 1.5 * pause_s)
            task = self.get(f"/v1/tasks/{task['task']}")
        if task["state"] != "done":
            msg = f"{task['title']}: {task['problem']}"
            raise SlabcellError(msg, number=int(task["number"]))
        return cast("Json", task["result"])

    def _ask(self, method: str, target: str, content: bytes | None, headers: dict[str, str]) -> Answer:
        connection = _Connection(self.path, self._timeout_s)
        try:
            connection.request(method, target, content, headers)
            response = connection.getresponse()
            raw = response.read(MAX_ANSWER_BYTES + 1)
        except (OSError, http.client.HTTPException) as error:
            raise self._explain(error) from error
        finally:
            connection.close()
        if len(raw) > MAX_ANSWER_BYTES:
            msg = f"{self.path}: the answer is larger than {MAX_ANSWER_BYTES >> 20} MiB"
            raise SlabcellError(msg)
        kind = response.headers.get_content_type()
        if response.status >= 400:
            raise _error(response.status, raw)
        return Answer(raw, kind, response.headers.get("etag", ""))

    def _explain(self, error: OSError | http.client.HTTPException) -> SlabcellError:
        if isinstance(error, PermissionError):
            return NotPermittedError(
                f"{self.path}: you may not use this socket; its group may: ask to be added to that group, or use sudo"
            )
        if isinstance(error, (FileNotFoundError, ConnectionRefusedError)):
            return UnavailableError(
                f"no daemon answers at {self.path}: is it running (systemctl status slabcell)?"
                " Another socket is named with --socket or SLABCELL_SOCKET"
            )
        if isinstance(error, TimeoutError):
            return UnavailableError(f"the daemon at {self.path} did not answer within {self._timeout_s:g} s")
        return UnavailableError(f"the daemon at {self.path} broke off: {error or type(error).__name__}")

    # Events

    def events(self, *, kinds: Sequence[str] = (), after: str | None = None, stay: bool = True) -> Iterator[ApiEvent]:
        """Return events as they happen, for ever; a lost connection is taken up again where it broke off.

        With ``stay`` False the end of the stream ends it.  Raises UnavailableError if the daemon stays away.
        """
        last, failures = after, 0
        while True:
            try:
                for event in self._stream(kinds, last):
                    last, failures = event.id, 0
                    yield event
            except UnavailableError:
                failures += 1
                if not stay or last is None or failures > 10:
                    raise
            if not stay:
                return
            time.sleep(min(2.0, 0.2 * (failures + 1)))

    def _stream(self, kinds: Sequence[str], after: str | None) -> Iterator[ApiEvent]:
        connection = _Connection(self.path, SILENCE_S)
        query = f"?{urlencode({'kinds': ','.join(kinds)})}" if kinds else ""
        try:
            connection.request("GET", f"/v1/events{query}", headers={"Last-Event-ID": after} if after else {})
            response = connection.getresponse()
            if response.status >= 400:
                raise _error(response.status, response.read(MAX_LINE_BYTES))
            yield from _parse(response)
        except (OSError, http.client.HTTPException) as error:
            raise self._explain(error) from error
        finally:
            connection.close()


def _parse(response: http.client.HTTPResponse) -> Iterator[ApiEvent]:
    fields: dict[str, str] = {}
    while line := response.readline(MAX_LINE_BYTES + 1):
        if len(line) > MAX_LINE_BYTES:
            msg = f"an event is longer than {MAX_LINE_BYTES >> 20} MiB"
            raise SlabcellError(msg)
        text = line.decode("utf-8").rstrip("\r\n")
        if text and not text.startswith(":"):
            name, _, value = text.partition(":")
            fields[name] = value.removeprefix(" ")
        elif not text and "data" in fields:
            yield ApiEvent(fields.get("id", ""), fields.get("event", "message"), json.loads(fields["data"]))
            fields = {}


def _object(answer: Answer) -> Json:
    try:
        content: object = json.loads(answer.content)
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        msg = f"the daemon's answer is no JSON: {error}"
        raise SlabcellError(msg) from error
    if not isinstance(content, dict):
        msg = "the daemon's answer is no JSON object"
        raise SlabcellError(msg)
    return cast("Json", content)


def _error(status: int, raw: bytes) -> SlabcellError:
    try:
        problem: object = json.loads(raw)
    except (UnicodeDecodeError, json.JSONDecodeError):
        problem = None
    words = cast("Json", problem) if isinstance(problem, dict) else {}
    detail, number = str(words.get("detail") or f"the daemon answered {status}"), int(words.get("number") or 0)
    action = f" ({words['action']})" if words.get("action") else ""
    kind = TemporaryError if status == 503 else SlabcellError
    return kind(f"{detail}{action}", number=number)
