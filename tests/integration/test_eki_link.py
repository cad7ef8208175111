"""The EKI server on a real socket: what a robot, a broken robot and a stranger get."""

import asyncio
import contextlib
import dataclasses
import socket

import pytest

from slabcell_drivers.robot.eki.answering import notice_dead_peer
from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.eki.framing import Framer
from slabcell_drivers.robot.eki.link import HANDLER_FAILED_CODE, Direction, EkiServer, EndReason
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import Answer, LinkState, Offer, Request, RequestType, ResultCode

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


async def test_a_request_gets_its_answer():
    offer = Offer(9, 0, 3, Frame(1, 2, 3), Frame(4, 5, 6), 0.5)

    async def handler(request):
        return Answer(request.session, 1, request.sequence, left=2, offer=offer)

    async with serving(handler) as link, Robot.connected(link) as robot:
        robot.send(ask(7))
        assert await robot.answer() == Answer(5, 1, 7, left=2, offer=offer)
        assert link.state is LinkState.CONNECTED


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


async def test_a_request_with_a_wrong_value_is_answered_as_a_bad_request():
    async with serving(echo) as link, Robot.connected(link) as robot:
        robot.send(encode_request(ask(4)).replace(b'Ver="1"', b'Ver="2"').replace(b'Ints="13"', b'Ints="14"'))
        answer = await robot.answer()
        assert (answer.acknowledges, answer.code) == (4, ResultCode.BAD_REQUEST)
        assert "version" in answer.message


async def test_nothing_but_garbage_ends_the_connection():
    async with serving(echo) as link, Robot.connected(link) as robot:
        robot.send(b"<Robot><bad></Robot>" * 16)
        await robot.until_closed()
    assert link.last_end is EndReason.GARBAGE


async def test_a_handler_that_raises_becomes_an_error_number_and_the_link_lives_on():
    async def handler(request):
        if request.sequence == 1:
            raise ZeroDivisionError
        return Answer(request.session, 1, request.sequence)

    async with serving(handler) as link, Robot.connected(link) as robot:
        robot.send(ask(1), ask(2))
        first, second = await robot.answer(), await robot.answer()
        assert (first.acknowledges, first.code) == (1, HANDLER_FAILED_CODE)
        assert (second.acknowledges, second.code) == (2, ResultCode.OK)


async def test_an_answer_that_cannot_be_sent_becomes_an_error_number():
    async def handler(request):
        return Answer(request.session, 1, request.sequence, offer=Offer(1, 0, 0, Frame(float("nan")), Frame(), 1.0))

    async with serving(handler) as link, Robot.connected(link) as robot:
        robot.send(ask(1))
        answer = await robot.answer()
        assert answer.code == HANDLER_FAILED_CODE
        assert "Pick/@X" in answer.message


async def test_a_heartbeat_is_answered_while_the_handler_works():
    release = asyncio.Event()

    async def handler(request):
        await release.wait()
        return Answer(request.session, 1, request.sequence)

    async with serving(handler) as link, Robot.connected(link) as robot:
        robot.send(ask(1), b'<Robot><Head Ver="1" Seq="0" Type="5"/></Robot>')
        assert await robot.read() == b"<VisHb></VisHb>"
        release.set()
        assert (await robot.answer()).acknowledges == 1


async def test_a_robot_whose_heartbeat_stops_is_lost():
    async with serving(echo, heartbeat_timeout_s=0.05) as link, Robot.connected(link) as robot:
        robot.send(ask(1, RequestType.HEARTBEAT))
        await robot.until_closed()
        assert link.state is LinkState.LISTENING
    assert link.last_end is EndReason.SILENT


async def test_a_robot_that_connects_anew_replaces_its_old_connection():
    async with serving(echo) as link, Robot.connected(link) as old:
        old.send(ask(1))
        await old.answer()
        async with Robot.connected(link) as new:
            new.send(ask(2))
            assert (await new.answer()).acknowledges == 2
            await old.until_closed()
            assert link.last_end is EndReason.REPLACED
            assert link.state is LinkState.CONNECTED


async def test_a_request_under_way_is_finished_before_the_new_connection_is_heard():
    started, release, seen = asyncio.Event(), asyncio.Event(), []

    async def handler(request):
        started.set()
        await release.wait()
        seen.append(request.sequence)
        return Answer(request.session, 1, request.sequence)

    async with serving(handler) as link:
        async with Robot.connected(link) as old:
            old.send(ask(1))
            await started.wait()
        async with Robot.connected(link) as new:
            new.send(ask(2))
            release.set()
            assert (await new.answer()).acknowledges == 2
    assert seen == [1, 2]


async def test_a_host_that_is_not_allowed_is_turned_away():
    async with serving(echo, allowed_hosts=frozenset({"192.0.2.1"})) as link, Robot.connected(link) as robot:
        await robot.until_closed()
        assert link.state is LinkState.LISTENING


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


async def test_stop_finishes_the_request_under_way_and_may_be_called_twice():
    started, release, done = asyncio.Event(), asyncio.Event(), []

    async def handler(request):
        started.set()
        await release.wait()
        done.append(request.sequence)
        return Answer(request.session, 1, request.sequence)

    link = EkiServer("127.0.0.1", 0)
    await link.stop()
    await link.start(handler)
    async with Robot.connected(link) as robot:
        robot.send(ask(1))
        await started.wait()
        stopping = asyncio.create_task(link.stop())
        release.set()
        await stopping
        await link.stop()
    assert done == [1]
    assert link.state is LinkState.CLOSED


async def test_a_taken_port_is_an_oserror():
    async with serving(echo) as link:
        other = EkiServer(*link.address)
        with pytest.raises(OSError, match="in use"):
            await other.start(echo)


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


async def test_changes_of_state_are_told():
    states = asyncio.Queue()
    async with serving(echo, on_state=states.put_nowait) as link:
        assert await states.get() is LinkState.LISTENING
        async with Robot.connected(link):
            assert await states.get() is LinkState.CONNECTED
        assert await states.get() is LinkState.LISTENING
    assert await states.get() is LinkState.CLOSED


async def test_the_answer_acknowledges_the_request_whatever_the_handler_says():
    async def handler(request):
        return dataclasses.replace(await echo(request), acknowledges=0)

    async with serving(handler) as link, Robot.connected(link) as robot:
        robot.send(ask(11))
        assert (await robot.answer()).acknowledges == 11


async def test_a_hook_that_raises_ends_its_connection_and_not_the_link():
    calls = []

    def hook(way, raw, at_s):
        calls.append(way)
        if len(calls) == 1:
            raise ValueError("disk full")

    async with serving(echo, on_telegram=hook) as link:
        async with Robot.connected(link) as robot:
            robot.send(ask(1))
            await robot.until_closed()
        async with Robot.connected(link) as robot:
            robot.send(ask(2))
            assert (await robot.answer()).acknowledges == 2
            assert link.last_end is EndReason.FAILED


def test_a_dead_peer_is_noticed_by_the_kernel_within_two_seconds():
    with socket.socket() as sock:
        notice_dead_peer(sock)
        first_probe_s = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE)
        apart_s = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL)
        probes = sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT)
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert first_probe_s + apart_s * probes <= 2
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 2000
