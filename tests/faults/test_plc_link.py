"""A job through a PLC, with cuts, delays, duplicates, stale toggles, half-written registers and slave exceptions.

No slab is picked twice, none is lost without a record.  Cell, ledger, links and the PLC's program are the real ones;
camera and eyes are scripted from the truth.  CI runs a few seeds; ``-m slow`` runs a thousand.
"""

import asyncio
import contextlib
import random
from collections import Counter
from pathlib import Path

import pytest

from slabcell_drivers.plc import JobProgram, OwnRegisters, PlcHandshake, Timeouts, WorldBody
from slabcell_drivers.plc.pty_pair import PtyPair
from slabcell_drivers.plc.simulated import CELL_AREAS
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
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.rtu_server import RtuRegisterServer
from slabcell_drivers.robot.modbus.tcp_server import TcpRegisterServer

from .plc_faults import KINDS, Faults, FaultyPort, FaultyStore, TcpProxy
from .squares import COMPLETE, PICK_BASE, PLACE_BASE, SLOTS, TOOL, Ending, World, judge, slots_and_states, squares_cell

pytestmark = pytest.mark.faults

MAP = load_map(Path(__file__).parents[2] / "config" / "modbus_map.toml")
LINKS = ("tcp-server", "tcp-client", "rtu-server", "rtu-client")
BAUD = 115_200
MAX_STARTS = 12
TIMEOUTS = Timeouts(answer_s=1.5, trigger_s=2.5, busy_s=0.02)
POLL_TIMEOUT_S = 0.1


@contextlib.asynccontextmanager
async def linked(name: str, handler, faults: Faults):
    """A link that serves the handler; gives the PLC's port, with the faults in between."""
    async with contextlib.AsyncExitStack() as stack:
        if name == "tcp-server":
            link = ModbusTcpServer("127.0.0.1", 0, MAP, access=Access(["127.0.0.1"]))
            link._server._store = FaultyStore(link._image, faults)
            await started(stack, link, handler)
            address = await stack.enter_async_context(TcpProxy.running(link.address, faults))
            port = RegisterClient(tcp_client(*address, POLL_TIMEOUT_S), MAP, timeout_s=POLL_TIMEOUT_S)
            stack.callback(port.close)
        elif name == "tcp-client":
            image = RegisterImage(MAP, peer_writes=CELL_AREAS)
            server = TcpRegisterServer(FaultyStore(image, faults), unit_id=1, access=Access(max_connections=16))
            await server.start("127.0.0.1", 0)
            stack.push_async_callback(server.stop)
            address = await stack.enter_async_context(TcpProxy.running(server.address, faults))
            registers = RegisterClient(tcp_client(*address, POLL_TIMEOUT_S), MAP, timeout_s=POLL_TIMEOUT_S)
            await started(stack, ModbusClient(registers, MAP, poll_s=0.003, retry_s=0.02), handler)
            port = OwnRegisters(image)
        else:
            line = await stack.enter_async_context(PtyPair(faults.wire))
            ends = [SerialSettings(end, BAUD, "N") for end in line.ends]
            if name == "rtu-server":
                link = ModbusRtuServer(ends[0], MAP)
                link._server._store = FaultyStore(link._image, faults)
                await started(stack, link, handler)
                port = RegisterClient(serial_client(ends[1], POLL_TIMEOUT_S), MAP, timeout_s=POLL_TIMEOUT_S)
                stack.callback(port.close)
            else:
                image = RegisterImage(MAP, peer_writes=CELL_AREAS)
                server = RtuRegisterServer(FaultyStore(image, faults), ends[1], unit_id=1)
                server.open()
                stack.callback(server.close)
                registers = RegisterClient(serial_client(ends[0], POLL_TIMEOUT_S), MAP, timeout_s=POLL_TIMEOUT_S)
                await started(stack, ModbusClient(registers, MAP, poll_s=0.003, retry_s=0.02), handler)
                port = OwnRegisters(image)
        yield FaultyPort(port, MAP, faults)


async def started(stack: contextlib.AsyncExitStack, link, handler) -> None:
    await link.start(handler)
    stack.push_async_callback(link.stop)


async def run_job(folder: Path, name: str, faults: Faults) -> Ending:
    world, log = World(), []
    async with squares_cell(folder, world) as (cell, ledger):

        async def handler(request):
            answer = await cell.handle(request)
            shown = f"code {answer.code} left {answer.left} offer {answer.offer and answer.offer.result_id}"
            log.append(f"{request.type.name} {request.session}/{request.sequence} {request.ack_state.name}: {shown}")
            return answer

        async with linked(name, handler, faults) as port:
            handshake = PlcHandshake(
                port, MAP, poll_s=0.003, ask_again_s=0.3, write_words=faults.random.choice([7, 123])
            )
            body = WorldBody(world, pick_base=PICK_BASE, place_base=PLACE_BASE, tool=TOOL)
            program = JobProgram(handshake.ask, body, timeouts=TIMEOUTS, link_tries=20)
            beating = asyncio.create_task(handshake.keep_beating())
            end, starts = await program.run(), 1
            while end.status == "halted" and starts < MAX_STARTS:
                end, starts = await program.run(), starts + 1
            beating.cancel()
            await asyncio.gather(beating, return_exceptions=True)
        offers = await slots_and_states(ledger)
    return Ending(world, offers, program.messages, end.status, starts, log)


@pytest.mark.parametrize("name", LINKS)
async def test_a_sound_link_lays_every_slab_once(tmp_path: Path, name: str) -> None:
    ending = await run_job(tmp_path, name, Faults(0, budget=0))
    judge(ending, name)
    assert sorted(ending.world.picks) == list(range(SLOTS))
    assert ending.texts == [COMPLETE]


COUNTS = [12, pytest.param(1000, marks=[pytest.mark.slow, pytest.mark.timeout(0)])]


@pytest.mark.parametrize("count", COUNTS)
async def test_nothing_is_picked_twice_or_lost_whatever_happens_on_the_way(tmp_path: Path, count: int) -> None:
    seed = random.randrange(2**31)
    print(f"{count} runs from seed {seed}")
    done: Counter[str] = Counter()
    complete = 0

    async def one(number: int) -> None:
        nonlocal complete
        faults, name = Faults(seed + number, budget=4), LINKS[number % len(LINKS)]
        folder = tmp_path / str(number)
        folder.mkdir()
        async with asyncio.timeout(60):
            ending = await run_job(folder, name, faults)
        judge(ending, f"{name}, seed {seed + number}: {dict(faults.done)}")
        done.update(faults.done)
        complete += ending.texts[-1] == COMPLETE

    for first in range(0, count, 4):
        await asyncio.gather(*(one(number) for number in range(first, min(first + 4, count))))
    print(f"{complete} of {count} jobs complete; faults: {dict(done)}")
    if count >= 100:
        assert set(done) == set(KINDS)
