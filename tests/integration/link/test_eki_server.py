"""The EKI server on a real socket: what a robot, a broken robot and a stranger get."""

import asyncio
import contextlib
import socket

import pytest

from slabcell_drivers.robot.answering import notice_dead_peer
from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.eki.framing import Framer
from slabcell_drivers.robot.eki.link import Direction, EkiServer, EndReason
from slabcell_drivers.robot.protocol import Answer, LinkState, Request, RequestType

pytestmark = pytest.mark.integration


class Robot:
    """A robot's end of the socket."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer
        self.framer = Framer("Vis", "VisHb")
        self.received = []

    @classmethod
    @contextlib.asynccontextmanager
    async def connected(cls, link):
        reader, writer = await asyncio.open_connection(*link.address)
        try:
            yield cls(reader, writer)
        finally:
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()

    def send(self, *requests):
        self.writer.write(b"".join(r if isinstance(r, bytes) else encode_request(r) for r in requests))

    async def read(self):
        while not self.received:
            data = await self.reader.read(4096)
            if not data:
                raise EOFError
            self.received += self.framer.feed(data)
        return self.received.pop(0)

    async def answer(self):
        return decode_answer(await self.read())

    async def until_closed(self):
        with contextlib.suppress(ConnectionError):
            while await self.reader.read(4096):
                pass


@contextlib.asynccontextmanager
async def serving(handler, **options):
    link = EkiServer("127.0.0.1", 0, **options)
    await link.start(handler)
    try:
        yield link
    finally:
        await link.stop()
    assert link.state is LinkState.CLOSED


async def echo(request):
    return Answer(request.session, 1, request.sequence, left=request.job_id)


def ask(sequence, type_=RequestType.NEXT, **values):
    return Request(type_, 5, sequence, **values)


async def test_requests_that_are_split_and_merged_are_answered_in_order():
    async with serving(echo) as link, Robot.connected(link) as robot:
        stream = b"\0 ".join(encode_request(ask(number)) for number in range(1, 6))
        for at in range(0, len(stream), 100):
            robot.send(stream[at : at + 100])
            await robot.writer.drain()
        assert [(await robot.answer()).acknowledges for _ in range(5)] == [1, 2, 3, 4, 5]


async def test_garbage_is_skipped_and_the_next_request_is_answered():
    async with serving(echo) as link, Robot.connected(link) as robot:
        robot.send(b"\xff\xfe rubbish </Robot>", b"<Robot><unclosed></Robot>", ask(3))
        assert (await robot.answer()).acknowledges == 3


async def test_nothing_but_garbage_ends_the_connection():
    async with serving(echo) as link, Robot.connected(link) as robot:
        robot.send(b"<Robot><bad></Robot>" * 16)
        await robot.until_closed()
    assert link.last_end is EndReason.GARBAGE


async def test_more_requests_than_lock_step_allows_end_the_connection():
    link = EkiServer("127.0.0.1", 0)
    blocked = asyncio.Event()

    async def slow(request):
        await blocked.wait()
        return Answer(request.session, 1, request.sequence)

    await link.start(slow)
    async with Robot.connected(link) as robot:
        robot.send(*(ask(number) for number in range(100)))
        await robot.until_closed()
    blocked.set()
    await link.stop()
    assert link.last_end is EndReason.FLOODED


async def test_the_transcript_sees_the_exact_bytes_in_both_directions():
    seen = []
    async with (
        serving(echo, on_telegram=lambda direction, raw, at_s: seen.append((direction, raw, at_s))) as link,
        Robot.connected(link) as robot,
    ):
        request = encode_request(ask(1))
        robot.send(request)
        answer = await robot.read()
    assert [entry[:2] for entry in seen] == [(Direction.RECEIVED, request), (Direction.SENT, answer)]
    assert seen[0][2] <= seen[1][2]


def test_a_dead_peer_is_noticed_by_the_kernel_within_two_seconds():
    with socket.socket() as sock:
        notice_dead_peer(sock)
        first_probe_s = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE)
        apart_s = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL)
        probes = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT)
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert first_probe_s + apart_s * probes <= 2
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 2000
