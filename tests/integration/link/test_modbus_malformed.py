"""Frames that no sound peer sends: no exception escapes, no register leaves its limits, connections end by rule.

The bytes go through the protocol objects that real sockets and lines use, with a transport that only takes notes;
``-m slow`` runs a hundred thousand of them for TCP and as many for a line.
"""

import asyncio

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slabcell_drivers.robot.link_events import EndReason
from slabcell_drivers.robot.modbus import Access, ModbusRtuServer, ModbusTcpServer, RegisterClient, SerialSettings
from slabcell_drivers.robot.modbus.client import tcp_client
from slabcell_drivers.robot.modbus.framing import ModbusFrame, rtu_frame, tcp_frame
from slabcell_drivers.robot.modbus.register_map import Area, RegisterType
from slabcell_drivers.robot.modbus.tcp_server import MAX_AT_ONCE, PeerConnection
from slabcell_drivers.robot.protocol import Answer, LinkState, Request, RequestType

from .conftest import MAP, PlcRobot

pytestmark = pytest.mark.integration

EXAMPLES = [300, pytest.param(100_000, marks=[pytest.mark.slow, pytest.mark.timeout(0)])]
FUNCTIONS = st.sampled_from([1, 2, 3, 4, 5, 6, 7, 8, 11, 15, 16, 20, 22, 23, 24, 43, 90, 128, 131, 255])
PDUS = st.one_of(
    st.binary(min_size=1, max_size=253),
    st.tuples(FUNCTIONS, st.integers(0, 65_535), st.integers(0, 65_535), st.binary(max_size=248)).map(
        lambda t: (bytes((t[0],)) + t[1].to_bytes(2, "big") + t[2].to_bytes(2, "big") + t[3])[:253]
    ),
    st.tuples(st.integers(0, 60), st.lists(st.integers(0, 65_535), min_size=1, max_size=60)).map(
        lambda t: (
            b"\x10"
            + t[0].to_bytes(2, "big")
            + len(t[1]).to_bytes(2, "big")
            + bytes((2 * len(t[1]),))
            + b"".join(word.to_bytes(2, "big") for word in t[1])
        )
    ),
)
FRAMES = st.builds(ModbusFrame, st.sampled_from([0, 1, 2, 255]), st.integers(0, 65_535), PDUS)


def damaged(draw_bytes):
    """A frame with some bytes changed, taken out, or put in."""
    return st.tuples(draw_bytes, st.lists(st.tuples(st.integers(0, 300), st.binary(max_size=3)), max_size=3)).map(
        lambda t: _damage(*t)
    )


def _damage(data, changes):
    for where, new in changes:
        at = where % (len(data) + 1)
        data = data[:at] + new + data[at + 1 :]
    return data


TCP_CHUNKS = st.lists(st.one_of(st.binary(max_size=400), damaged(FRAMES.map(tcp_frame))), min_size=1, max_size=6)
RTU_CHUNKS = st.lists(
    st.one_of(st.binary(max_size=400), damaged(FRAMES.map(lambda frame: rtu_frame(frame.unit, frame.pdu)))),
    min_size=1,
    max_size=6,
)


class Notes(asyncio.Transport):
    """A transport that takes notes."""

    def __init__(self):
        super().__init__({"peername": ("127.0.0.1", 5)})
        self.written, self.ended = [], False

    def write(self, data):
        self.written.append(data)

    def close(self):
        self.ended = True

    abort = close

    def get_write_buffer_size(self):
        return 0


async def echo(request):
    return Answer(request.session, request.sequence, request.sequence)


def within_limits(image):
    for register in MAP.registers:
        if register.type is not RegisterType.TEXT:
            value = image.value(register.area, register.name)
            assert register.low * register.scale <= value <= register.high * register.scale, register.name


def cheap(examples):
    return settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), database=None)


@pytest.mark.parametrize("examples", EXAMPLES)
def test_whatever_a_tcp_peer_sends_the_registers_stay_within_their_limits(examples, monkeypatch):
    monkeypatch.setattr("slabcell_drivers.robot.modbus.tcp_server.notice_dead_peer", lambda _sock: None)
    loop = asyncio.new_event_loop()
    link = ModbusTcpServer("127.0.0.1", 0, MAP)
    loop.run_until_complete(link.start(echo))
    ended = dict.fromkeys(EndReason, 0)

    @cheap(examples)
    @given(chunks=TCP_CHUNKS)
    def feed(chunks):
        async def talk():
            ours = link._image.get(Area.CELL_LIFE)[2:], link._image.get(Area.ANSWER)
            peer, transport = PeerConnection(link._server), Notes()
            peer.connection_made(transport)
            for chunk in chunks:
                peer.data_received(chunk)
                within_limits(link._image)
                answered = link._image.value(Area.REQUEST, "toggle") == link._image.value(Area.ANSWER, "toggle")
                assert answered or ours[1] == link._image.get(Area.ANSWER)
            assert transport.ended == (peer.end_reason is not None)
            if peer.end_reason is not None:
                assert peer.end_reason in {EndReason.GARBAGE, EndReason.FLOODED}
                ended[peer.end_reason] += 1
            assert all(2 < len(frame) <= 260 for frame in transport.written)
            peer.connection_lost(None)

        loop.run_until_complete(talk())

    try:
        feed()
        print(f"{examples} examples; connections ended: { {str(k): n for k, n in ended.items() if n} }")
        assert ended[EndReason.GARBAGE] > 0
    finally:
        loop.run_until_complete(link.stop())
        loop.close()


@pytest.mark.parametrize("examples", EXAMPLES)
def test_whatever_a_line_brings_the_registers_stay_within_their_limits(examples):
    loop = asyncio.new_event_loop()
    link = ModbusRtuServer(SerialSettings("/dev/slabcell-absent", 115_200, "N"), MAP)
    loop.run_until_complete(link.start(echo))

    @cheap(examples)
    @given(chunks=RTU_CHUNKS)
    def feed(chunks):
        async def talk():
            for chunk in chunks:
                link._server._received(chunk)
                within_limits(link._image)
                assert link._server._framer.pending <= 1000
            link._server._was_silent()
            assert link._server._framer.pending == 0

        loop.run_until_complete(talk())

    try:
        feed()
    finally:
        loop.run_until_complete(link.stop())
        loop.close()


# ------------------------------------------------------------------------------------------------- on a real socket


async def connected(link):
    return await asyncio.open_connection(*link.address)


async def until_closed(reader):
    while await reader.read(4096):
        pass


@pytest.fixture
async def link():
    link = ModbusTcpServer("127.0.0.1", 0, MAP, access=Access(["127.0.0.1"], max_connections=2))
    await link.start(echo)
    yield link
    await link.stop()


@pytest.mark.parametrize(
    "data",
    [
        b"\0\1\0\1\0\6\1\3\0\0\0\1",  # another protocol
        b"\0\1\0\0\xff\xff\1",  # a length that no frame has
        b"GET / HTTP/1.1\r\n\r\n",
        tcp_frame(ModbusFrame(1, 1, b"\x2b\x0e\x01\x00")) * 16,  # sixteen refused in a row
        tcp_frame(ModbusFrame(1, 1, b"\3\0\0\0\1")) * (MAX_AT_ONCE + 1),
    ],
    ids=["protocol", "length", "http", "refused", "flood"],
)
async def test_a_connection_ends_by_rule_and_the_next_one_is_served(link, data):
    reader, writer = await connected(link)
    writer.write(data)
    await asyncio.wait_for(until_closed(reader), 10)
    writer.close()
    robot = PlcRobot(RegisterClient(tcp_client(*link.address, 5.0), MAP, timeout_s=5.0))
    assert (await robot.ask(Request(RequestType.NEXT, 1, 1))).acknowledges == 1
    await robot.close()


async def test_a_frame_that_stays_incomplete_ends_its_connection(link):
    reader, writer = await connected(link)
    writer.write(b"\0\1\0\0\0\6\1\3")
    await asyncio.wait_for(until_closed(reader), 10)
    writer.close()
    assert link.counters.malformed == 1


async def test_requests_that_arrive_together_are_all_answered_in_their_order(link):
    """pymodbus's own server answers the last one only."""
    reader, writer = await connected(link)
    writer.write(b"".join(tcp_frame(ModbusFrame(1, number, b"\3\0\0\0\1")) for number in range(1, 6)))
    answers = await reader.readexactly(5 * 11)
    assert [int.from_bytes(answers[at : at + 2], "big") for at in range(0, 55, 11)] == [1, 2, 3, 4, 5]
    writer.close()


async def test_one_connection_more_than_the_limit_is_turned_away_and_counted(link, until):
    first, second = await connected(link), await connected(link)
    await until(lambda: len(link._server.connections) == 2)
    third = await connected(link)
    assert await third[0].read(1) == b""
    assert link.counters.refused_limit == 1
    for _, writer in (first, second, third):
        writer.close()
    await until(lambda: not link._server.connections)
    fourth = await connected(link)
    await until(lambda: len(link._server.connections) == 1)
    fourth[1].close()


async def test_a_peer_that_is_not_on_the_list_is_turned_away_and_counted():
    link = ModbusTcpServer("127.0.0.1", 0, MAP, access=Access(["192.0.2.0/24", "198.51.100.7"]))
    await link.start(echo)
    reader, writer = await connected(link)
    with_reset = False
    try:
        assert await reader.read(1) == b""
    except ConnectionResetError:
        with_reset = True
    writer.close()
    assert link.counters.refused_peers == 1
    assert link.counters.connections == 0
    assert link.state is LinkState.LISTENING, with_reset
    await link.stop()


async def test_a_second_writer_from_elsewhere_is_told_that_the_device_is_busy(link, until):
    one, two = PeerConnection(link._server), PeerConnection(link._server)
    for peer, host in ((one, "127.0.0.1"), (two, "127.0.0.2")):
        transport = Notes()
        peer._transport, peer.host = transport, host
        link._server.connections.add(peer)
    write = tcp_frame(ModbusFrame(1, 1, b"\6\0\0\0\1"))
    one.data_received(write)
    two.data_received(write)
    assert one._transport.written == [write]
    assert two._transport.written[0][7:] == b"\x86\x06"
    assert link.counters.refused_writes == 1
    two.data_received(tcp_frame(ModbusFrame(1, 2, b"\3\0\0\0\1")))
    assert two._transport.written[1][7:] == b"\3\2\0\1"
    for peer in (one, two):
        peer.connection_lost(None)
