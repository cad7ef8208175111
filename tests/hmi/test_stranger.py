"""What an attacker sends is answered in a few words: no page of an error, no file, no login, no page that hangs."""

from __future__ import annotations

import io
import json
import os
import re
import socket
import struct
import subprocess
import zipfile
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote, urlencode, urlsplit

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from slabcell.hmi.pages import PAGES
from slabcell.hmi.route import HmiRoute

from .conftest import LIMIT_S, PASSWORD, SLABCELL, Cell, Client, Server, hmi_server

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

ROUTES = [route for page in PAGES for route in page.routes]
NASTY = (
    "",
    "../../../../etc/passwd",
    "..%2f..%2fetc%2fpasswd",
    "\0",
    "a\r\nSet-Cookie: slabcell=x",
    "<script>alert(1)</script>",
    "{{ 7 * 7 }}",
    "=cmd|' /C calc'!A1",
    "\N{GRINNING FACE}\u00e4\u0661",
    "1e999",
    "nan",
    "999999999999999",
    "99999999999999999999",
    "x" * 3000,
)
FIELDS = (
    *("after", "again", "base", "before", "board", "csv", "cycle", "file", "job", "kind", "language", "layers", "name"),
    *("next", "number", "others", "password", "poses", "recipe", "result", "role", "slot", "task", "theme"),
    *("thickness", "thickness_mm", "to", "token", "touch", "unit", "verdict", "view"),
)
DEEP = b"[" * 100_000


def name_of(route: HmiRoute) -> str:
    return f"{route.method} {route.path}"


def addresses(route: HmiRoute) -> Iterator[str]:
    """Yield what may be asked of a route: each bad value in each place of its path, and in every field."""
    for value in NASTY:
        path = re.sub(r"\{[^}]+\}", quote(value, safe="")[:4000] or "-", route.path)
        yield f"{path}?{urlencode(dict.fromkeys(FIELDS, value[:250]))}"


@pytest.fixture(autouse=True)
def unharmed(request: pytest.FixtureRequest) -> Iterator[None]:
    """Nothing may fail within an HMI meanwhile, which would say so in its log."""
    servers = [request.getfixturevalue(name) for name in ("hmi", "alone") if name in request.fixturenames]
    before = [len(server.child.log.read_text()) for server in servers]
    yield
    for server, start in zip(servers, before, strict=True):
        said = server.child.log.read_text()[start:]
        assert "page failed" not in said
        assert "Traceback" not in said


def harmless(text: str) -> None:
    """The answer shows nothing of a file or of our code, and nothing that was sent has become part of the page."""
    for sign in ("root:x:", "Traceback", 'File "', "<script>alert"):
        assert sign not in text


@pytest.mark.parametrize("route", [route for route in ROUTES if route.method == "GET"], ids=name_of)
def test_no_address_breaks_a_page(hmi: Server, route: HmiRoute) -> None:
    client = hmi.client("admin")
    for address in addresses(route):
        answer = client.get(address)
        assert answer.status < 500 or answer.status == 503, (address, answer.text)  # the bench may be busy
        if not answer.headers.get("content-type", "").startswith("image/"):
            harmless(answer.content.decode(errors="replace"))
        assert "slabcell=x" not in answer.headers.get("set-cookie", "")


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """An HMI without a daemon, so that what is asked for in vain harms no cell; it has one admin."""
    folder = tmp_path_factory.mktemp("alone")
    with hmi_server(folder / "no-daemon.sock", folder) as server:
        fields = {"token": server.token, "name": "admin", "password": PASSWORD, "again": PASSWORD}
        assert Client(server.base).post("/first", fields, HX_Request="").status == 303
        yield server


@pytest.mark.parametrize("route", [route for route in ROUTES if route.method == "POST"], ids=name_of)
def test_no_form_or_content_breaks_a_page(alone: Server, route: HmiRoute) -> None:
    client = Client(alone.base, comes_from="127.0.0.6") if route.role is None else alone.client("admin")
    path = re.sub(r"\{[^}]+\}", "1", route.path)
    fixed = {"Origin": client.base, "X-Slabcell-Form": client.form, "HX-Request": "true"}
    form = "application/x-www-form-urlencoded"
    for value in NASTY:
        fields = urlencode(dict.fromkeys(FIELDS, value)).encode()
        answer = client.ask("POST", path, fields, {**fixed, "Content-Type": form})
        assert answer.status in {200, 303, 400, 401, 403, 404, 409, 413, 415, 422, 429, 503}, (value, answer.text)
        harmless(answer.text)
    for content in (
        b"",
        DEEP[: route.body_bytes],
        b"\xff\xfe\0",
        b"{",
        b"null",
        b"[]",
        b'{"base": {"a": NaN}}',
        b"a&&=%%%",
    ):
        for kind in {form, route.raw or form, "application/json"}:
            answer = client.ask("POST", path, content, {**fixed, "Content-Type": kind})
            assert answer.status < 500 or answer.status == 503, (content[:40], kind, answer.text)


# Uploads, in front of the cell that reads them


def png(width: int, height: int, pixels: bytes = b"") -> bytes:
    """Return a picture in grey of any size; its pixels are what is said, or a few zeros."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(pixels, 9)) + chunk(b"IEND", b"")


def tiff(width: int, height: int) -> bytes:
    """Return the head of a picture that says it is large."""
    tags = ((256, 4, width), (257, 4, height), (258, 3, 8), (259, 3, 1), (262, 3, 1), (273, 4, 8), (279, 4, 1))
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(tags)) + entries + b"\0\0\0\0"


def packed(size: int) -> bytes:
    """Return an archive of zeros."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("frame.png", bytes(size))
    return stream.getvalue()


UPLOADS = {
    "a picture of 60000 x 60000 that is a bomb": png(60_000, 60_000, bytes(8 << 20)),
    "a picture of 2^31 pixels a side": png(0x7FFFFFFF, 0x7FFFFFFF),
    "a picture of no size": png(0, 0),
    "a picture that ends too early": png(1920, 1200, bytes(1000)),
    "a picture of another kind that says it is large": tiff(60_000, 60_000),
    "an archive of 64 MB of zeros": packed(64 << 20),
    "a line that does not end": b"0,0," * 100_000,
    "a million empty lines": b"\n" * 1_000_000,
    "zeros": bytes(100_000),
    "no text": b"\xff\xfe\xfa" * 1000,
    "a deep list": DEEP,
    "a drawing of nested blocks": b"0\nSECTION\n2\nBLOCKS\n" + b"0\nBLOCK\n2\nA\n0\nINSERT\n2\nA\n0\nENDBLK\n" * 1000,
    "numbers without end": b"1" * 100_000 + b",2\n",
    "infinities": b"inf,nan,1e999,-inf,0,0,1,1\n" * 100,
}


@pytest.mark.parametrize("what", UPLOADS)
@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/templates/check?file=x", "application/octet-stream"),
        ("/tune/upload", "application/octet-stream"),
        ("/calibrate/upload", "application/json"),
    ],
)
def test_what_is_uploaded_breaks_nothing_and_the_cell_lives_on(
    cell: Cell, hmi: Server, path: str, kind: str, what: str
) -> None:
    client = hmi.client("engineer")
    headers = {"Origin": client.base, "X-Slabcell-Form": client.form, "HX-Request": "true", "Content-Type": kind}
    answer = client.ask("POST", path, UPLOADS[what], headers)
    assert answer.status in {200, 400, 409, 413, 422, 503}, answer.text
    harmless(answer.text)
    assert cell.api.get("/v1/status")["state"]


# Requests


def raw(server: Server, content: bytes, address: str = "127.0.0.1") -> bytes:
    """Return what comes back for these bytes until the other side ends the connection, or has answered."""
    host, _, port = urlsplit(server.base).netloc.rpartition(":")
    with socket.create_connection((host, int(port)), LIMIT_S, source_address=(address, 0)) as link:
        found = b""
        with suppress(ConnectionError):  # cut off while it still sent
            link.sendall(content)
            link.shutdown(socket.SHUT_WR)
            while more := link.recv(65_536):
                found += more
        return found


@pytest.mark.parametrize(
    "head",
    [
        b"X: " + b"x" * 40_000,
        b"Cookie: " + b"a=b; " * 8000,
        b"\r\n".join(b"X%d: y" % number for number in range(4000)),
        b"Content-Length: 5\r\nContent-Length: 6",
        b"Content-Length: -5",
        b"Transfer-Encoding: chunked, chunked",
        b"Host: evil.example",
        b"X : y",
        b"X: a\0b",
    ],
    ids=lambda head: head[:24].decode(),
)
def test_a_head_that_is_too_large_or_means_two_things_is_refused(alone: Server, head: bytes) -> None:
    host = urlsplit(alone.base).netloc.encode()
    answer = raw(alone, b"POST /login HTTP/1.1\r\nHost: " + host + b"\r\n" + head + b"\r\n\r\nname=a")
    assert answer.startswith((b"HTTP/1.1 400 ", b"HTTP/1.1 413 ", b"HTTP/1.1 431 ")) or not answer, answer[:200]


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "evil.example:80",
        "[::1",
        "a b",
        "@localhost",
    ],
)
def test_a_host_that_is_not_ours_gets_nothing(alone: Server, host: str) -> None:
    answer = raw(alone, f"GET /login HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    assert answer.startswith((b"HTTP/1.1 421 ", b"HTTP/1.1 400 ")), answer[:200]


@pytest.mark.parametrize(
    "origin",
    [
        *(
            "null",
            "http://[",
            "http://[::1",
            "file://",
            "http://evil.example",
            "{base}.evil.example",
            "{base}@evil.example",
        ),
        *(
            "https://{host}",
            "http://evil.example/{base}",
            "{base}, http://evil.example",
            "http://localhost:1",
            "{host}",
        ),
    ],
)
def test_an_origin_that_is_not_this_page_is_refused(alone: Server, origin: str) -> None:
    text = origin.format(base=alone.base, host=urlsplit(alone.base).netloc)
    client = alone.client("admin")
    answer = client.post("/users/add", {"name": "mallory", "role": "admin"}, Origin=text)
    assert answer.status == 403
    assert client.post("/login", {"name": "admin", "password": PASSWORD}, Origin=text).status == 403


def test_only_the_methods_of_a_route_are_answered(alone: Server) -> None:
    client = alone.client("admin")
    for method in ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "CONNECT", "PROPFIND"):
        assert client.ask(method, "/users").status in {400, 404, 405}, method
    assert client.ask("HEAD", "/users").content == b""
    assert client.ask("GET", "/users/remove").status == 405


def test_one_who_holds_connections_does_not_keep_others_out(alone: Server) -> None:
    host, _, port = urlsplit(alone.base).netloc.rpartition(":")
    held = [socket.create_connection((host, int(port)), LIMIT_S, source_address=("127.0.0.9", 0)) for _ in range(220)]
    try:
        assert Client(alone.base).get("/login").status == 200
    finally:
        for link in held:
            link.close()


# Logins


def test_guesses_that_are_made_at_once_are_counted_too(alone: Server) -> None:
    def guess(number: int) -> int:
        client = Client(alone.base, comes_from="127.0.0.8")
        return client.post("/login", {"name": "guessed-at-once", "password": f"guess {number}"}).status

    with ThreadPoolExecutor(16) as threads:
        statuses = list(threads.map(guess, range(16)))
    assert sorted(statuses) == [403] * 5 + [429] * 11


def test_the_token_of_the_first_start_makes_one_admin_of_two_at_once(tmp_path: Path) -> None:
    with hmi_server(tmp_path / "no-daemon.sock", tmp_path) as server:

        def first(name: str) -> int:
            fields = {"token": server.token, "name": name, "password": PASSWORD, "again": PASSWORD}
            return Client(server.base).post("/first", fields, HX_Request="").status

        assert Client(server.base).post("/first", {"token": "guessed", "name": "mallory"}).status == 403
        with ThreadPoolExecutor(2) as threads:
            statuses = sorted(threads.map(first, ("anna", "bert")))
        assert statuses[0] == 303
        assert statuses[1] in {403, 404}
        assert server.child.log.read_text().count(server.token) == 0, "a secret is no line of a log"


def listen(link: ClientConnection) -> None:
    """Read what comes until the link ends."""
    while True:
        link.recv(LIMIT_S)


@pytest.mark.parametrize("end", ["logout", "role", "password", "remove"])
def test_a_live_link_ends_with_its_login(hmi: Server, end: str) -> None:
    admin, name = hmi.client("admin"), f"watcher-{end}"
    secret = {"password": PASSWORD, "again": PASSWORD}
    assert admin.post("/users/add", {"name": name, "role": "viewer", **secret}).status == 200
    watcher = hmi.fresh_client(name)
    cookie = "; ".join(f"{key}={value}" for key, value in watcher.cookies.items())
    address = f"ws://{urlsplit(hmi.base).netloc}/live"
    with connect(address, additional_headers={"Cookie": cookie}, origin=hmi.base, max_size=None) as link:
        link.recv(LIMIT_S)
        if end == "logout":
            assert watcher.post("/logout").status == 200
        else:
            fields = {"name": name, "role": "operator", **secret}
            assert admin.post(f"/users/{end}", fields).status == 200
        with pytest.raises(ConnectionClosed) as closed:
            listen(link)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
    assert Client(hmi.base, dict(watcher.cookies)).get("/").status == 303
    if end != "remove":
        assert admin.post("/users/remove", {"name": name}).status == 200


def test_a_login_is_in_the_audit_log_by_its_name_and_a_guess_is_not(alone: Server) -> None:
    admin = Client(alone.base, comes_from="127.0.0.7")
    assert admin.login("admin").status == 303
    Client(alone.base).post("/login", {"name": "\x1b[2Jroot[red]", "password": "guessed, too"})
    shown = admin.get("/users").text
    assert "<td>admin</td><td>127.0.0.7</td><td>/login" in shown
    assert "guessed, too" not in shown
    words = ["hmi", "audit", "--config", str(Path(__file__).parents[2] / "config" / "demo.toml")]
    said = command(words, alone.state)
    assert "\x1b[2J" not in said
    assert json.loads(command([*words, "--json"], alone.state))["lines"]


def command(words: list[str], state: Path) -> str:
    """Return what a verb prints of this HMI's file of users."""
    environment = {**os.environ, "SLABCELL__HMI__STATE_DIRECTORY": str(state), "COLUMNS": "200"}
    done = subprocess.run(
        [*SLABCELL, *words], capture_output=True, text=True, timeout=LIMIT_S, check=True, env=environment
    )
    return done.stdout
