"""Every link between robot and cell, and the robot at its other end, for tests that hold for all of them."""

import asyncio
import contextlib
from pathlib import Path

import pytest

from slabcell_drivers.plc import OwnRegisters, PlcHandshake
from slabcell_drivers.plc.pty_pair import PtyPair
from slabcell_drivers.robot.eki import EkiClient, EkiServer
from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.eki.framing import Framer
from slabcell_drivers.robot.modbus import (
    Access,
    ModbusClient,
    ModbusRtuServer,
    ModbusTcpServer,
    RegisterClient,
    SerialSettings,
    load_map,
    serial_client,
    tcp_client,
)
from slabcell_drivers.robot.modbus.codec import decode_answer as modbus_answer
from slabcell_drivers.robot.modbus.codec import encode_request as modbus_request
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.register_map import Area, check_words
from slabcell_drivers.robot.modbus.rtu_server import RtuRegisterServer
from slabcell_drivers.robot.modbus.tcp_server import TcpRegisterServer
from slabcell_drivers.robot.protocol import LinkState, Request, RequestType

MAP = load_map(Path(__file__).parents[3] / "config" / "modbus_map.toml")
CELL_AREAS = frozenset({Area.CELL_LIFE, Area.ANSWER})
BAUD = 115_200


class EkiRobot:
    """A robot's end of an EKI connection."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer
        self.framer = Framer("Vis", "VisHb")
        self.received = []

    async def _read(self):
        while not self.received:
            data = await self.reader.read(4096)
            if not data:
                raise EOFError
            self.received += self.framer.feed(data)
        return self.received.pop(0)

    async def ask(self, request):
        self.writer.write(encode_request(request))
        return decode_answer(await self._read())

    async def ask_in_version_2(self, request):
        raw = encode_request(request)
        ints = int(raw.split(b'Ints="')[1].split(b'"')[0])
        raw = raw.replace(b'Ver="1"', b'Ver="2"').replace(b'Ints="%d"' % ints, b'Ints="%d"' % (ints + 1))
        self.writer.write(raw)
        return decode_answer(await self._read())

    async def beat(self):
        """Give a sign of life and see that the cell has noticed."""
        self.writer.write(encode_request(Request(RequestType.HEARTBEAT, 0, 0)))
        assert await self._read() == b"<VisHb></VisHb>"

    async def until_closed(self):
        with contextlib.suppress(ConnectionError):
            while await self.reader.read(4096):
                pass

    async def close(self):
        self.writer.close()
        with contextlib.suppress(OSError):
            await self.writer.wait_closed()


class PlcRobot:
    """A PLC's end of a Modbus link."""

    def __init__(self, port):
        self.port = port
        self.handshake = PlcHandshake(port, MAP, poll_s=0.002, ask_again_s=5.0)

    async def ask(self, request):
        return await self.handshake.ask(request, 10.0)

    async def ask_in_version_2(self, request):
        start, count = MAP.span(Area.ANSWER)
        toggle = 1 - (await self.port.read(start, count))[-1]
        words = modbus_request(MAP, request, toggle)
        words[0] = 2
        check = check_words(words[:-3])
        words[-3:-1] = [check >> 16, check & 0xFFFF]
        await self.port.write(MAP.span(Area.REQUEST)[0], words)
        while True:
            answer = await self.port.read(start, count)
            if answer[-1] == toggle:
                return modbus_answer(MAP, answer)
            await asyncio.sleep(0.002)

    async def beat(self):
        await self.handshake.beat()
        beaten = self.handshake._watchdog
        echo = MAP.register(Area.CELL_LIFE, "watchdog_echo").address
        while (await self.port.read(echo, 1))[0] != beaten:  # noqa: ASYNC110 - a PLC polls
            await asyncio.sleep(0.002)

    async def until_closed(self):
        """Until the cell has closed the connection: a poll fails then."""
        await _until(lambda: not self.port.connected)

    async def close(self):
        if isinstance(self.port, RegisterClient):
            self.port.close()


class EkiServerRig:
    name = "eki-server"
    keeps_its_wire = False

    @contextlib.asynccontextmanager
    async def serving(self, handler, *, hosts=(), **options):
        async with _started(EkiServer("127.0.0.1", 0, allowed_hosts=frozenset(hosts), **options), handler) as link:
            yield link

    @contextlib.asynccontextmanager
    async def robot(self, link):
        robot = EkiRobot(*await asyncio.open_connection(*link.address))
        try:
            yield robot
        finally:
            await robot.close()

    def another(self, link):
        return EkiServer(*link.address)


class EkiClientRig:
    name = "eki-client"
    keeps_its_wire = False

    @contextlib.asynccontextmanager
    async def serving(self, handler, **options):
        self.connections = asyncio.Queue()
        server = await asyncio.start_server(lambda r, w: self.connections.put_nowait((r, w)), "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        try:
            async with _started(EkiClient("127.0.0.1", port, retry_s=0.02, **options), handler) as link:
                yield link
        finally:
            while not self.connections.empty():
                await EkiRobot(*self.connections.get_nowait()).close()
            server.close()
            await server.wait_closed()

    @contextlib.asynccontextmanager
    async def robot(self, link):
        robot = EkiRobot(*await self.connections.get())
        try:
            yield robot
        finally:
            await robot.close()


class ModbusTcpServerRig:
    name = "modbus-tcp-server"
    keeps_its_wire = False

    @contextlib.asynccontextmanager
    async def serving(self, handler, *, hosts=(), **options):
        link = ModbusTcpServer("127.0.0.1", 0, MAP, access=Access(hosts), **options)
        async with _started(link, handler):
            yield link

    @contextlib.asynccontextmanager
    async def robot(self, link):
        robot = PlcRobot(RegisterClient(tcp_client(*link.address, 5.0), MAP, timeout_s=5.0))
        await robot.port.connect()
        try:
            with contextlib.suppress(OSError):  # a host that is turned away cannot even write
                await robot.port.write(1, [0])  # only who writes counts as the robot
            yield robot
        finally:
            await robot.close()

    def another(self, link):
        return ModbusTcpServer(*link.address, MAP)


class ModbusTcpClientRig:
    name = "modbus-tcp-client"
    keeps_its_wire = True

    @contextlib.asynccontextmanager
    async def serving(self, handler, **options):
        self.image = RegisterImage(MAP, peer_writes=CELL_AREAS)
        server = TcpRegisterServer(self.image, unit_id=1, access=Access())
        await server.start("127.0.0.1", 0)
        self.server = server
        try:
            registers = RegisterClient(tcp_client(*server.address, 5.0), MAP, timeout_s=5.0)
            link = ModbusClient(registers, MAP, poll_s=0.002, retry_s=0.02, **options)
            async with _started(link, handler):
                yield link
        finally:
            await server.stop()

    @contextlib.asynccontextmanager
    async def robot(self, link):
        await _until(lambda: link.state is LinkState.CONNECTED)
        yield PlcRobot(_Memory(self.image, self.server))
        for connection in tuple(self.server.connections):
            connection.end(connection.end_reason)
            connection._transport.abort()


class ModbusRtuServerRig:
    name = "modbus-rtu-server"
    keeps_its_wire = True

    @contextlib.asynccontextmanager
    async def serving(self, handler, **options):
        async with PtyPair() as self.line:
            self.settings = SerialSettings(self.line.ends[0], BAUD, "N")
            async with _started(ModbusRtuServer(self.settings, MAP, **options), handler) as link:
                yield link

    @contextlib.asynccontextmanager
    async def robot(self, link):
        make = serial_client(SerialSettings(self.line.ends[1], BAUD, "N"), 2.0)
        robot = PlcRobot(RegisterClient(make, MAP, timeout_s=2.0))
        await robot.port.connect()
        try:
            await robot.port.write(1, [0])
            yield robot
        finally:
            await robot.close()

    def another(self, link):
        return ModbusRtuServer(self.settings, MAP)


class ModbusRtuClientRig:
    name = "modbus-rtu-client"
    keeps_its_wire = True

    @contextlib.asynccontextmanager
    async def serving(self, handler, **options):
        async with PtyPair() as line:
            self.image = RegisterImage(MAP, peer_writes=CELL_AREAS)
            self.server = RtuRegisterServer(self.image, SerialSettings(line.ends[1], BAUD, "N"), unit_id=1)
            self.server.open()
            registers = RegisterClient(serial_client(SerialSettings(line.ends[0], BAUD, "N"), 0.2), MAP, timeout_s=0.2)
            link = ModbusClient(registers, MAP, poll_s=0.002, retry_s=0.02, **options)
            try:
                async with _started(link, handler):
                    yield link
            finally:
                self.server.close()

    @contextlib.asynccontextmanager
    async def robot(self, link):
        await _until(lambda: link.state is LinkState.CONNECTED)
        yield PlcRobot(OwnRegisters(self.image))
        self.server.close()


class _Memory(OwnRegisters):
    """A PLC's own registers; the PLC counts as connected while the cell is."""

    def __init__(self, image, server):
        super().__init__(image)
        self._server = server
        self._seen = set(server.connections)

    @property
    def connected(self):
        return bool(self._seen & self._server.connections)


@contextlib.asynccontextmanager
async def _started(link, handler):
    await link.start(handler)
    try:
        yield link
    finally:
        await link.stop()
    assert link.state is LinkState.CLOSED


async def _until(condition):
    while not condition():  # noqa: ASYNC110 - what is waited for tells nobody
        await asyncio.sleep(0.002)


RIGS = (EkiServerRig, EkiClientRig, ModbusTcpServerRig, ModbusTcpClientRig, ModbusRtuServerRig, ModbusRtuClientRig)


@pytest.fixture(params=RIGS, ids=lambda rig: rig.name)
def rig(request):
    return request.param()


@pytest.fixture(params=(EkiServerRig, ModbusTcpServerRig), ids=lambda rig: rig.name)
def tcp_rig(request):
    """Links that robots connect to over TCP."""
    return request.param()


@pytest.fixture(params=(EkiServerRig, ModbusTcpServerRig, ModbusRtuServerRig), ids=lambda rig: rig.name)
def waiting_rig(request):
    """Links that take an address or a line for themselves."""
    return request.param()


@pytest.fixture
def until():
    """Wait, by looking again and again, for what tells nobody when it comes."""
    return _until
