"""One simulated cell and one HMI for all tests of a worker, and clients that speak HTTP as a browser does."""

from __future__ import annotations

import http.client
import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit

import pytest

from slabcell.service.api.client import ApiClient

LIMIT_S = 90.0
SLABCELL = [sys.executable, "-c", "from slabcell.cli import main; main()"]
PASSWORD = "correct horse battery"  # noqa: S105 - of users that live as long as a test
ROLES = ("viewer", "operator", "engineer", "admin")
HERE = Path(__file__).parent


def wait_for(what: Callable[[], object], why: str) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + LIMIT_S
    while not what():
        assert time.monotonic() < deadline, f"did not come: {why}"
        time.sleep(0.05)


class Child:
    """A process that says lines."""

    def __init__(self, words: list[str], log: Path, *, pass_fds: Sequence[int] = (), **environment: str) -> None:
        self.log = log
        self._log = log.open("a")
        self._read = b""
        self.process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            pass_fds=tuple(pass_fds),
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
        )

    def line(self) -> str:
        """Return the next line."""
        assert self.process.stdout is not None
        while b"\n" not in self._read:
            assert select.select([self.process.stdout], [], [], LIMIT_S)[0], self.log.read_text()
            more = os.read(self.process.stdout.fileno(), 4096)
            assert more, self.log.read_text()
            self._read += more
        line, _, self._read = self._read.partition(b"\n")
        return line.decode().strip()

    def write(self, line: str) -> None:
        """Give it a line to read."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n".encode())
        self.process.stdin.flush()

    def end(self) -> None:
        """End it."""
        with suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
        try:
            self.process.wait(20.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self._log):
            if stream is not None:
                stream.close()


@dataclass
class Cell:
    """The simulated cell's process."""

    child: Child
    socket: Path
    folder: Path

    @property
    def api(self) -> ApiClient:
        return ApiClient(self.socket)

    def tell(self, command: str) -> str:
        """Have it do something; return what it says of it."""
        self.child.write(command)
        return self.child.line()

    def lay(self) -> None:
        """Lay a template with new slabs."""
        self.tell("strew")
        assert self.tell("lay").startswith("done")

    def kept_cycle(self) -> int:
        """Return the number of the newest cycle that found slabs and is kept, which it is a little later."""
        found: list[int] = []

        def look() -> bool:
            cycles = self.api.get("/v1/cycles", limit=30)["cycles"]
            found[:] = [item["cycle"] for item in cycles if item["bundle"] and item["found"]]
            return bool(found)

        wait_for(look, "a cycle that is kept")
        return found[0]


@dataclass
class Answer:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    content: bytes

    @property
    def text(self) -> str:
        return self.content.decode()

    @property
    def said(self) -> dict[str, str]:
        """What the page would show of an action."""
        return json.loads(self.headers["hx-trigger"])["slab:say"]


@dataclass
class Client:
    """One browser, as far as HTTP goes: it keeps cookies and sends what browsers send."""

    base: str
    cookies: dict[str, str] = field(default_factory=dict)
    form: str = ""
    """The form token of the last page."""
    comes_from: str = "127.0.0.1"
    """Any address of loopback: tries to log in are counted by it."""

    def ask(
        self, method: str, path: str, body: bytes | None = None, headers: Mapping[str, str] | None = None
    ) -> Answer:
        """Send one request."""
        host = urlsplit(self.base).netloc
        connection = http.client.HTTPConnection(host, timeout=LIMIT_S, source_address=(self.comes_from, 0))
        sent: dict[str, str] = {"Host": host}
        if self.cookies:
            sent["Cookie"] = "; ".join(f"{name}={value}" for name, value in self.cookies.items())
        sent |= dict(headers or {})
        try:
            connection.request(method, path, body, {name: value for name, value in sent.items() if value})
            response = connection.getresponse()
            content = response.read()
        finally:
            connection.close()
        for name, line in response.getheaders():
            if name.lower() == "set-cookie":
                self._keep(line)
        answer = Answer(response.status, {name.lower(): value for name, value in response.getheaders()}, content)
        if found := re.search(rb'X-Slabcell-Form": "([^"]+)"', content):
            self.form = found[1].decode()
        return answer

    def _keep(self, line: str) -> None:
        name, _, value = line.partition(";")[0].partition("=")
        if "max-age=0" in line.lower():
            self.cookies.pop(name, None)
        else:
            self.cookies[name] = value

    def get(self, path: str, **headers: str) -> Answer:
        """Read."""
        return self.ask("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})

    def post(self, path: str, fields: Mapping[str, Any] | None = None, **headers: str) -> Answer:
        """Do something as a page of ours does it: with origin and form token."""
        sent = {
            "Origin": self.base,
            "Content-Type": "application/x-www-form-urlencoded",
            "X-Slabcell-Form": self.form,
            "HX-Request": "true",
            **{name.replace("_", "-"): value for name, value in headers.items()},
        }
        return self.ask("POST", path, urlencode(fields or {}).encode(), sent)

    def login(self, name: str, password: str = PASSWORD) -> Answer:
        """Log in, and load the first page."""
        answer = self.post("/login", {"name": name, "password": password}, HX_Request="")
        self.get("/")
        return answer


@dataclass
class Server:
    """One HMI's process."""

    base: str
    state: Path
    child: Child
    token: str = ""
    logged_in: dict[str, Client] = field(default_factory=dict)

    def client(self, role: str = "") -> Client:
        """Return a browser, logged in as the user that is called like a role; its session is shared by tests."""
        if role and role not in self.logged_in:
            self.logged_in[role] = self.fresh_client(role)
        known = self.logged_in[role] if role else Client(self.base)
        return replace(known, cookies=dict(known.cookies))

    def fresh_client(self, role: str) -> Client:
        """Return a browser with a session of its own."""
        client = Client(self.base)
        answer = client.login(role)
        assert answer.status == 303, answer.text
        return client


@contextmanager
def hmi_server(socket: Path, folder: Path, **environment: str) -> Iterator[Server]:
    """Run an HMI beside a daemon's socket."""
    state = folder / "hmi"
    config = Path(__file__).parents[2] / "config" / "demo.toml"
    child = Child(
        [*SLABCELL, "hmi", "--config", str(config)],
        folder / "hmi.log",
        SLABCELL__API__SOCKET=str(socket),
        SLABCELL__HMI__STATE_DIRECTORY=str(state),
        SLABCELL__HMI__PORT="0",
        **environment,
    )
    try:
        line = child.line()
        assert line.startswith("open "), child.log.read_text()
        base = line.removeprefix("open ").rstrip("/")
        yield Server(base, state, child, child.line().rpartition(" ")[2])
    finally:
        child.end()


@pytest.fixture(scope="session")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell that lives; its robot is as fast as it can be."""
    folder = tmp_path_factory.mktemp("cell")
    words = [sys.executable, str(HERE / "cell_process.py"), str(folder), "dresden", "5", "0"]
    child = Child(words, folder / "cell.log")
    try:
        word, _, socket = child.line().partition(" ")
        assert word == "ready", child.log.read_text()
        yield Cell(child, Path(socket), folder)
    finally:
        child.end()


@pytest.fixture(scope="session")
def hmi(cell: Cell, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """An HMI with a user for each role, made as people make them: the admin by the token, the others by the admin."""
    with hmi_server(cell.socket, tmp_path_factory.mktemp("hmi"), SLABCELL__HMI__LIVE_CLIENTS="64") as server:
        client = Client(server.base)
        fields = {"token": server.token, "name": "admin", "password": PASSWORD, "again": PASSWORD}
        assert client.post("/first", fields, HX_Request="").status == 303
        client.get("/")
        for role in ROLES[:-1]:
            answer = client.post("/users/add", {"name": role, "role": role, "password": PASSWORD, "again": PASSWORD})
            assert answer.status == 200, answer.text
        yield server


@pytest.fixture(scope="package")
def browser() -> Iterator[Any]:
    """One Chromium for all tests of the pages in a worker.

    It ends with them: Playwright's loop runs in this thread as long as there is one, and lets no other loop run here.
    """
    from .browser import opened_browser  # only tests that need it

    with opened_browser() as running:
        yield running
