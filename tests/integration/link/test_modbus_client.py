"""The cell polls a PLC or gateway: what may be in its memory, and what it may refuse."""

import contextlib

import pytest

from slabcell_drivers.plc import OwnRegisters, PlcHandshake
from slabcell_drivers.robot.modbus import Access, ModbusClient, RegisterClient, tcp_client
from slabcell_drivers.robot.modbus.codec import encode_request
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.register_map import Area
from slabcell_drivers.robot.modbus.tcp_server import TcpRegisterServer
from slabcell_drivers.robot.protocol import Answer, LinkState, Request, RequestType

from .conftest import CELL_AREAS, MAP

pytestmark = pytest.mark.integration


async def echo(request):
    return Answer(request.session, request.sequence, request.sequence)


@contextlib.asynccontextmanager
async def polled(image, handler=echo, **options):
    """A PLC with this memory, and a link that polls it."""
    server = TcpRegisterServer(image, unit_id=1, access=Access())
    await server.start("127.0.0.1", 0)
    registers = RegisterClient(tcp_client(*server.address, 1.0), MAP, timeout_s=1.0)
    link = ModbusClient(registers, MAP, poll_s=0.002, retry_s=0.02, **options)
    await link.start(handler)
    try:
        yield link, server
    finally:
        await link.stop()
        await server.stop()


@pytest.fixture
def image():
    return RegisterImage(MAP, peer_writes=CELL_AREAS)


async def test_a_request_that_waits_in_the_plc_when_the_cell_starts_is_answered(image, until):
    image.set(Area.REQUEST, encode_request(MAP, Request(RequestType.HELLO, 0, 8), 1))
    async with polled(image):
        await until(lambda: image.value(Area.ANSWER, "toggle") == 1)
        assert image.value(Area.ANSWER, "ack_sequence") == 8


async def test_a_request_that_was_answered_before_the_cell_started_is_not_asked_again(image, until):
    seen = []

    async def handler(request):
        seen.append(request.sequence)
        return await echo(request)

    async with polled(image, handler):
        await PlcHandshake(OwnRegisters(image), MAP, poll_s=0.002).ask(Request(RequestType.NEXT, 5, 8), 5.0)
    beats = image.value(Area.CELL_LIFE, "watchdog")
    async with polled(image, handler):
        await until(lambda: image.value(Area.CELL_LIFE, "watchdog") != beats)
        await PlcHandshake(OwnRegisters(image), MAP, poll_s=0.002).ask(Request(RequestType.NEXT, 5, 9), 5.0)
    assert seen == [8, 9]


async def test_a_write_of_ours_that_arrives_late_over_a_newer_one_does_not_stop_the_talk(image):
    """A gateway that delivers late leaves an old toggle in the PLC's memory; then both sides waited for each other."""
    async with polled(image):
        plc = PlcHandshake(OwnRegisters(image), MAP, poll_s=0.002, ask_again_s=0.05)
        for sequence in (1, 2, 3):
            assert (await plc.ask(Request(RequestType.NEXT, 5, sequence), 5.0)).acknowledges == sequence
            image.set_value(Area.ANSWER, "toggle", 1 - image.value(Area.ANSWER, "toggle"))


async def test_an_answer_that_the_plc_refuses_is_given_again(image, until):
    refused = []

    class Refusing:
        def __getattr__(self, name):
            return getattr(image, name)

        def write(self, address, words):
            if address >= 104 and len(refused) < 3:
                refused.append(address)
                image.write(60_000, words)  # raises: no such address
            image.write(address, words)

    async with polled(Refusing()) as (link, _):
        answer = await PlcHandshake(OwnRegisters(image), MAP, poll_s=0.002).ask(Request(RequestType.NEXT, 5, 8), 5.0)
        assert answer.acknowledges == 8
        assert link.state is LinkState.CONNECTED
        assert link.failed_polls == 3
    assert len(refused) == 3


async def test_a_plc_that_comes_later_or_again_is_found(image, until):
    server = TcpRegisterServer(image, unit_id=1, access=Access())
    await server.start("127.0.0.1", 0)
    address = server.address
    registers = RegisterClient(tcp_client(*address, 0.5), MAP, timeout_s=0.5)
    link = ModbusClient(registers, MAP, poll_s=0.002, retry_s=0.02)
    await link.start(echo)
    try:
        await until(lambda: link.state is LinkState.CONNECTED)
        await server.stop()
        await until(lambda: link.state is LinkState.LISTENING)
        await server.start(*address)
        answer = await PlcHandshake(OwnRegisters(image), MAP, poll_s=0.002).ask(Request(RequestType.NEXT, 5, 1), 5.0)
        assert answer.acknowledges == 1
    finally:
        await link.stop()
        await server.stop()


async def test_half_a_request_is_not_taken_until_the_rest_has_come(image, until):
    seen = []

    async def handler(request):
        seen.append(request)
        return await echo(request)

    words = encode_request(MAP, Request(RequestType.NEXT, 5, 8, job_id=3), 1)
    async with polled(image, handler) as (link, _):
        image.set(Area.REQUEST, words[:20] + [0] * 27 + words[-1:])
        await until(lambda: link._exchange.torn > 3)
        assert not seen
        image.set(Area.REQUEST, words)
        await until(lambda: image.value(Area.ANSWER, "toggle") == 1)
    assert [request.sequence for request in seen] == [8]


async def test_pymodbus_own_server_is_a_plc_too():
    """The peer implementation, with registers that are nothing but memory."""
    from pymodbus.server import ModbusTcpServer as PeerServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    memory = SimDevice(1, [SimData(0, count=200, values=0, datatype=DataType.REGISTERS)])
    peer = PeerServer(memory, address=("127.0.0.1", 0))
    await peer.serve_forever(background=True)
    port = peer.transport.sockets[0].getsockname()[1]
    registers = RegisterClient(tcp_client("127.0.0.1", port, 1.0), MAP, timeout_s=1.0)
    link = ModbusClient(registers, MAP, poll_s=0.005, retry_s=0.02)
    await link.start(echo)
    plc = RegisterClient(tcp_client("127.0.0.1", port, 1.0), MAP, timeout_s=1.0)
    await plc.connect()
    try:
        handshake = PlcHandshake(plc, MAP, poll_s=0.005)
        for sequence in (1, 2):
            answer = await handshake.ask(Request(RequestType.NEXT, 5, sequence), 5.0)
            assert answer.acknowledges == sequence
    finally:
        plc.close()
        await link.stop()
        await peer.shutdown()
