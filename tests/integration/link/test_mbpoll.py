"""A client that is nobody's of ours: mbpoll, of the distribution, reads and writes every register of the map."""

import asyncio
import os
import re
import shutil
import subprocess

import pytest

from slabcell_drivers.plc.pty_pair import PtyPair
from slabcell_drivers.robot.modbus import Access, ModbusRtuServer, ModbusTcpServer, SerialSettings
from slabcell_drivers.robot.modbus.register_map import Area, RegisterType
from slabcell_drivers.robot.protocol import Answer

from .conftest import MAP

pytestmark = pytest.mark.integration

TYPES = {RegisterType.UINT16: "4", RegisterType.INT32: "4:int", RegisterType.UINT32: "4:int"}


async def echo(request):
    return Answer(request.session, request.sequence, request.sequence)


@pytest.fixture(autouse=True)
def _needs_mbpoll():
    if shutil.which("mbpoll") is None:
        if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
            pytest.fail("mbpoll is not installed, and CI has to have it")
        pytest.skip("needs mbpoll: `./run test` installs it")


class Mbpoll:
    """Runs the program beside the link, which lives in this process."""

    def __init__(self, *where):
        self._where = where

    async def __call__(self, *words, values=()):
        command = ["mbpoll", "-q", "-0", "-1", "-B", "-a", "1", "-o", "2", *words, *self._where]
        command += ["--", *map(str, values)] if values else []
        return await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=30)

    async def read(self, address, count, kind="4:hex"):
        done = await self("-r", str(address), "-c", str(count), "-t", kind)
        assert done.returncode == 0, done.stdout + done.stderr
        return [
            int(value, 0) for value in re.findall(r"^\[\d+\]:\s+(-?(?:0x)?[0-9A-Fa-f]+)", done.stdout, re.MULTILINE)
        ]


async def read_and_write_everything(link, mbpoll):
    image = link._image
    for area in Area:
        start, count = MAP.span(area)
        image.set(area, [(7919 * at) & 0xFFFF for at in range(start, start + count)])
        for kind in ("4:hex", "3:hex"):  # holding registers, input registers
            before, seen, after = image.get(area), await mbpoll.read(start, count, kind), image.get(area)
            # the cell counts its watchdog on meanwhile: what changes while it is read proves nothing
            still = [i for i in range(count) if before[i] == after[i]]
            assert [seen[i] for i in still] == [after[i] for i in still]
            assert len(still) >= count - 4
        image.set(area, [0] * count)
    for register in MAP.registers:
        if register.type is RegisterType.TEXT:
            continue
        raw = int(register.high * register.scale) if register.high < 2**31 else 123_456
        done = await mbpoll("-r", str(register.address), "-t", TYPES[register.type], values=[raw])
        written = image.value(register.area, register.name)
        if register.area.written_by_plc:
            assert (done.returncode, written) == (0, raw), (register.name, done.stdout, done.stderr)
            back = await mbpoll.read(register.address, 1, TYPES[register.type])
            assert back == [raw]
            await mbpoll("-r", str(register.address), "-t", TYPES[register.type], values=[0])
        else:
            assert done.returncode != 0, register.name
            assert written == 0 or register.name == "watchdog"
    for address, refused in ((50, "Illegal data address"), (7, "Illegal data value")):
        done = await mbpoll("-r", str(address), "-t", "4", values=[9])
        assert refused in done.stdout + done.stderr
    done = await mbpoll("-r", "0", "-t", "0", values=[1])  # the coil
    assert done.returncode == 0, done.stderr
    assert image.value(Area.PLC_LIFE, "io_command") == 1
    image.set_value(Area.CELL_LIFE, "io_state", 0b101)
    assert await mbpoll.read(0, 3, "1") == [1, 0, 1]


async def test_every_register_is_read_and_written_over_tcp():
    link = ModbusTcpServer("127.0.0.1", 0, MAP, access=Access(["127.0.0.1"]))
    await link.start(echo)
    try:
        await read_and_write_everything(link, Mbpoll("-m", "tcp", "-p", str(link.address[1]), "127.0.0.1"))
        assert link.counters.malformed == 0
        assert link.counters.refused_peers == 0
    finally:
        await link.stop()


async def test_every_register_is_read_and_written_over_a_serial_line():
    async with PtyPair() as line:
        link = ModbusRtuServer(SerialSettings(line.ends[0], 115_200, "N"), MAP)
        await link.start(echo)
        try:
            where = ("-m", "rtu", "-b", "115200", "-P", "none", line.ends[1])
            await read_and_write_everything(link, Mbpoll(*where))
            assert link.counters.malformed == 0
        finally:
            await link.stop()
