"""Who is slow, never reads or opens too many connections is cut off; nobody else notices."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket
from websockets.asyncio.client import connect

from slabcell.http_server import HttpConnection, serving

pytestmark = pytest.mark.unit

LIMIT_S = 60.0
GET = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"


async def hello(_: Request) -> PlainTextResponse:
    return PlainTextResponse("hello")


async def large(request: Request) -> StreamingResponse:
    async def chunks() -> AsyncIterator[bytes]:
        try:
            for _ in range(1000):
                yield b"x" * 65_536
        finally:
            request.app.state.ended.set()

    return StreamingResponse(chunks())


async def echo(link: WebSocket) -> None:
    await link.accept()
    await link.send_text(await link.receive_text())
    await link.close()


APP = Starlette(routes=[Route("/", hello), Route("/large", large), WebSocketRoute("/live", echo)])


class Hasty(HttpConnection):
    """Has little time."""

    head_timeout_s = 0.3
    read_timeout_s = 0.3


class Few(HttpConnection):
    """Has little room."""

    max_connections = 5
    max_of_one_address = 3


@asynccontextmanager
async def served(connection: type[HttpConnection]) -> AsyncIterator[int]:
    listening = socket.create_server(("127.0.0.1", 0))
    listening.setblocking(False)
    port: int = listening.getsockname()[1]
    async with serving(APP, listening, connection=connection, name="test", keep_alive_s=30, ws="websockets-sansio"):
        yield port
    listening.close()


@asynccontextmanager
async def client(
    port: int, address: str = "127.0.0.1"
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0))
    try:
        yield reader, writer
    finally:
        writer.close()
        with suppress(ConnectionError):
            await writer.wait_closed()


async def ended(reader: asyncio.StreamReader) -> bytes:
    """Return what comes until the other side ends the connection."""
    async with asyncio.timeout(LIMIT_S):
        try:
            return await reader.read()
        except ConnectionResetError:
            return b""


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\nHost: local"], ids=["nothing", "half a head"])
async def test_a_head_that_does_not_come_ends_the_connection(begun: bytes) -> None:
    async with served(Hasty) as port, client(port) as (reader, writer):
        writer.write(begun)
        assert await ended(reader) == b""


async def test_a_second_head_that_is_begun_and_not_ended_ends_the_connection() -> None:
    async with served(Hasty) as port, client(port) as (reader, writer):
        writer.write(GET)
        assert (await reader.readuntil(b"hello")).startswith(b"HTTP/1.1 200")
        writer.write(GET[:-2])
        assert await ended(reader) == b""


async def test_who_does_not_read_is_cut_off() -> None:
    APP.state.ended = asyncio.Event()
    async with served(Hasty) as port, client(port) as (reader, writer):
        writer.write(GET.replace(b"/ ", b"/large "))
        got = len(await reader.readexactly(1))
        writer.transport.pause_reading()
        async with asyncio.timeout(LIMIT_S):
            await APP.state.ended.wait()
        writer.transport.resume_reading()
        got += len(await ended(reader))
    assert got < 1000 * 65_536


async def test_a_live_link_outlives_the_time_of_a_head() -> None:
    async with served(Hasty) as port, connect(f"ws://127.0.0.1:{port}/live") as link:
        async with client(port) as (reader, _):
            await ended(reader)  # a connection of the same age is gone by now
        async with client(port) as (reader, _):
            await ended(reader)
        await link.send("there")
        assert await link.recv() == "there"


async def test_one_address_has_so_many_connections_and_others_still_have_room() -> None:
    async with served(Few) as port, client(port) as (one, _), client(port), client(port) as (three, writer):
        async with client(port) as (four, _):
            assert await ended(four) == b""
        writer.write(GET)
        await three.readuntil(b"hello")
        async with client(port, "127.0.0.2") as (other, writing), client(port, "127.0.0.2"):
            writing.write(GET)
            await other.readuntil(b"hello")
            async with client(port, "127.0.0.3") as (late, _):
                assert await ended(late) == b"", "all are taken"
        assert not one.at_eof()
