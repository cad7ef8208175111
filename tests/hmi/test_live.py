"""The live link: for pages of ours with a login only, nothing is sent that was not asked for, and seats are counted."""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from .conftest import LIMIT_S, PASSWORD, Cell, Client, Server, hmi_server

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]


@contextmanager
def live(client: Client, origin: str | None = None) -> Iterator[ClientConnection]:
    cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
    address = f"ws://{urlsplit(client.base).netloc}/live"
    headers = {"Cookie": cookie} if cookie else {}
    with connect(address, additional_headers=headers, origin=origin or client.base, max_size=None) as socket:
        yield socket


def test_a_stranger_and_a_foreign_page_get_no_live_link(hmi: Server) -> None:
    for client, origin in ((hmi.client(), None), (hmi.client("viewer"), "http://evil.example")):
        with pytest.raises(InvalidStatus) as refused, live(client, origin):
            pass
        assert refused.value.response.status_code == 403


def test_a_picture_comes_only_when_it_is_asked_for_and_no_old_one_is_kept(cell: Cell, hmi: Server) -> None:
    cell.api.post("/v1/trigger")
    with live(hmi.client("viewer")) as socket:
        socket.send("picture")
        shown = next_picture(socket)
        assert shown["frame"] == cell.api.get("/v1/frames/latest")["frame"]
        for _ in range(3):
            cell.api.post("/v1/trigger")
        newest = cell.api.get("/v1/frames/latest")["frame"]
        beats = 0
        while beats < 3:
            message = socket.recv(LIMIT_S)
            assert isinstance(message, str), "a picture that was not asked for"
            content = json.loads(message)
            assert "picture" not in content
            beats += not content["kinds"]
        frames: list[object] = []
        while newest not in frames:  # the HMI fetches two in a second at most, and may be about to
            socket.send("picture")
            frames.append(next_picture(socket)["frame"])
        assert shown["frame"] not in frames, "an older one was kept"


def next_picture(socket: ClientConnection) -> dict[str, object]:
    announced: dict[str, object] = {}
    while True:
        message = socket.recv(LIMIT_S)
        if isinstance(message, bytes):
            assert message.startswith(b"\xff\xd8"), "no JPEG"
            return announced
        announced = json.loads(message).get("picture", announced)


def test_so_many_pages_and_no_more(cell: Cell, tmp_path: Path) -> None:
    with hmi_server(cell.socket, tmp_path, SLABCELL__HMI__LIVE_CLIENTS="2") as server, ExitStack() as stack:
        client = Client(server.base)
        client.post("/first", {"token": server.token, "name": "admin", "password": PASSWORD, "again": PASSWORD})
        for _ in range(2):
            stack.enter_context(live(client)).recv(LIMIT_S)
        late = stack.enter_context(live(client))
        with pytest.raises(ConnectionClosed) as closed:
            late.recv(LIMIT_S)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1013
