"""The daemon behind a PLC: a whole job over each link, a gripper on the cell's I/O, a light on a serial line."""

import asyncio
import contextlib
import json
import os
import select
import subprocess
import time
from pathlib import Path

import pytest

from slabcell.service.modbus_config import shipped_map
from slabcell.template import load_template
from slabcell_drivers.light import SimulatedController, load_presets
from slabcell_drivers.plc import Timeouts
from slabcell_drivers.plc.simulated import SimulatedPlc, polled_over_tcp
from slabcell_drivers.robot import Frame
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.modbus import Access, RegisterClient, tcp_client
from slabcell_drivers.robot.modbus.image import ExceptionCode, RefusedError
from slabcell_drivers.robot.modbus.tcp_server import TcpRegisterServer

from .conftest import SLABCELL, TOOL

pytestmark = [pytest.mark.integration, pytest.mark.timeout(240)]

CONFIG = Path(__file__).parents[3] / "config"
MAP = shipped_map()
LIMIT_S = 90.0
TIMEOUTS = Timeouts(answer_s=20.0, trigger_s=60.0)


def with_modbus(cell, link, *lines):
    cell.edit('model = "kr3r540"', f'model = "kr3r540"\nlink = "{link}"')
    cell.edit("[table]", "\n".join(["[robot.modbus]", *lines, "", "[table]"]))


def assert_laid(placements):
    assert all(placement.filled for placement in placements)
    assert max(abs(value) for p in placements for value in (p.dx_mm, p.dy_mm, p.dtheta_deg)) < 0.3


def placements_of(cell):
    slots = load_template(CONFIG / "templates" / "dresden.csv").slots
    return cell.world.world.placements([slot.vertices for slot in slots])


def test_a_plc_that_polls_lays_the_pattern_with_the_light_switched_for_each_picture(cell) -> None:
    preset = load_presets(CONFIG / "lights.toml")["gardasoft-rt"]
    with_modbus(cell, "modbus-tcp", "port = 0", 'peers = ["127.0.0.1"]')

    async def job():
        async with SimulatedController(preset) as light:
            light_table = f'[light]\nurl = "{light.device}"\npreset = "gardasoft-rt"\nmode = "with-trigger"\n'
            cell.edit("[robot]", light_table + "\n[robot]")
            running = cell.daemon()
            daemon = await asyncio.to_thread(running.__enter__)
            try:
                await asyncio.to_thread(cell.wait_for_log, "camera open")
                port = RegisterClient(tcp_client(*daemon.address, 2.0), MAP, timeout_s=2.0)
                plc = SimulatedPlc(cell.world.world, port, MAP, arm=KR3_R540, tool=TOOL, timeouts=TIMEOUTS)
                end = await asyncio.wait_for(plc.run(), LIMIT_S)
                port.close()
                ledger = await asyncio.to_thread(cell.slabcell, "alarms", "list", "--json")
                first = (await asyncio.to_thread(daemon.client.get, "/v1/cycles"))["cycles"][-1]
                file = await asyncio.to_thread(daemon.client.fetch, f"/v1/cycles/{first['cycle']}/files/telegrams.json")
                telegrams = json.loads(file.content)
            finally:
                await asyncio.to_thread(running.__exit__, None, None, None)
            return end, list(light.received), ledger, telegrams

    end, commands, _, telegrams = asyncio.run(job())
    assert {item["direction"] for item in telegrams} == {"received", "sent"}
    assert all(len(word) == 4 for item in telegrams for word in item["telegram"].split())
    assert (end.status, end.message) == ("done", "Job complete: every slot is filled")
    assert_laid(placements_of(cell))
    switched = [command for command in commands if command.startswith("RS")]
    assert switched[:2] == ["RS1,100", "RS1,0"]
    assert len(switched) >= 4


def test_the_plc_of_the_command_line_lays_the_pattern_over_a_serial_line(cell) -> None:
    """Two programs of ours, and a line between them: nothing is shared but the world, which is the PLC's."""
    host = cell.camera.address.rsplit(".", 1)[0].replace("127.0.19", "127.0.20")
    address = f"{host}.{cell.camera.address.rsplit('.', 1)[1]}"
    plc = subprocess.Popen(
        [*SLABCELL, "sim", "plc", "--pty", "--camera", address, "--seed", "5"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert plc.stderr is not None
        device = ""
        while not device:
            assert select.select([plc.stderr], [], [], LIMIT_S)[0], "the PLC did not say where its line is"
            line = plc.stderr.readline()
            assert line, plc.stderr.read()
            device = line.removeprefix("line for the cell: ").strip() if line.startswith("line for") else ""
        cell.edit(f'camera = "{cell.camera.address}"', f'camera = "{address}"')
        with_modbus(cell, "modbus-rtu", f'device = "{device}"', "baud_rate = 115200", 'parity = "none"')
        with cell.daemon() as daemon:
            assert daemon.address == (device, 0)
            out, errors = plc.communicate(timeout=LIMIT_S)
    finally:
        with contextlib.suppress(ProcessLookupError):
            plc.kill()
        plc.communicate()
    document = json.loads(out)
    assert document["ok"], (document, errors, (cell.folder / "daemon.log").read_text()[-3000:])
    assert document["picks"] == [1] * len(document["picks"])


class Coupler:
    """An I/O coupler with the gripper's valve and switches."""

    def __init__(self, world) -> None:
        self.world, self.tcp, self.interlock = world, Frame, True

    def write_coils(self, wire_address, values):
        if wire_address != 3:
            raise RefusedError(ExceptionCode.ILLEGAL_ADDRESS)
        if values[0]:
            self.world.grip(self.tcp())
        else:
            self.world.release(self.tcp())

    def read_inputs(self, wire_address, count):
        return [{5: self.world.vacuum, 6: self.interlock}[at] for at in range(wire_address, wire_address + count)]


def test_a_plc_that_is_polled_lays_the_pattern_with_a_gripper_on_the_cell_s_own_io(cell) -> None:
    coupler = Coupler(cell.world.world)

    async def job():
        io = TcpRegisterServer(coupler, unit_id=1, access=Access())
        await io.start("127.0.0.1", 0)
        places = asyncio.Queue()
        try:
            async with polled_over_tcp(MAP, "127.0.0.1", 0, places.put_nowait) as port:
                host, number = places.get_nowait()
                gripper = f'[robot.modbus.gripper]\nhost = "127.0.0.1"\nport = {io.address[1]}\n'
                gripper += "vacuum_coil = 3\npart_present_input = 5\ninterlock_input = 6"
                with_modbus(cell, "modbus-tcp", 'role = "client"', f'host = "{host}"', f"port = {number}", gripper)
                running = cell.daemon()
                await asyncio.to_thread(running.__enter__)
                try:
                    await asyncio.to_thread(cell.wait_for_log, "camera open")
                    plc = SimulatedPlc(
                        *(cell.world.world, port, MAP),
                        arm=KR3_R540,
                        tool=TOOL,
                        timeouts=TIMEOUTS,
                        gripper_at_cell=True,
                    )
                    coupler.tcp = lambda: plc.body.tcp
                    coupler.interlock = False
                    refused = await until_message(plc, "1207")
                    coupler.interlock = True
                    await until_closed(plc)
                    end = await asyncio.wait_for(plc.run(starts=3), LIMIT_S)
                finally:
                    await asyncio.to_thread(running.__exit__, None, None, None)
        finally:
            await io.stop()
        return refused, end

    refused, end = asyncio.run(job())
    assert refused.startswith("1207")
    assert (end.status, end.message) == ("done", "Job complete: every slot is filled")
    assert_laid(placements_of(cell))
    assert set(cell.world.world.pick_counts) == {1}


async def until_message(plc, number):
    deadline = time.monotonic() + LIMIT_S
    while True:
        end = await plc.run()
        if end.message.startswith(number):
            return end.message
        assert time.monotonic() < deadline, end


async def until_closed(plc):
    while not await plc.handshake.gripper_state() & 0b10:  # noqa: ASYNC110 - a PLC polls
        await asyncio.sleep(0.02)


def test_a_light_that_is_lost_is_an_alarm_and_a_refused_trigger_and_goes_when_it_is_back(cell) -> None:
    preset = load_presets(CONFIG / "lights.toml")["gardasoft-rt"]

    async def job():
        async with SimulatedController(preset) as light:
            cell.edit("[robot]", f'[light]\nurl = "{light.device}"\npreset = "gardasoft-rt"\n\n[robot]')
            running = cell.daemon()
            await asyncio.to_thread(running.__enter__)
            try:
                await asyncio.to_thread(cell.wait_for_log, "camera open")
                standing = []
                for silent in (False, True, False):
                    light.silent = silent
                    standing.append(await asyncio.to_thread(until_alarm, cell, standing=silent))
                return standing
            finally:
                await asyncio.to_thread(running.__exit__, None, None, None)

    assert asyncio.run(job()) == [False, True, False]


def until_alarm(cell, *, standing):
    deadline = time.monotonic() + LIMIT_S
    while True:
        done = cell.slabcell("alarms", "list", "--json")
        numbers = [alarm["number"] for alarm in json.loads(done.stdout)["alarms"]]
        if (1150 in numbers) is standing:
            return standing
        assert time.monotonic() < deadline, done.stdout
