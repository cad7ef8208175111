"""How does a whole job run behind a PLC without hardware?  `SimulatedPlc`: handshake, robot program, arm and world."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager

from slabcell_drivers.plc.body import CellGripper, WorldBody
from slabcell_drivers.plc.handshake import PlcHandshake
from slabcell_drivers.plc.program import JobEnd, JobProgram, Timeouts
from slabcell_drivers.plc.registers import OwnRegisters, RegisterPort
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.modbus.access import Access
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.register_map import Area, RegisterMap
from slabcell_drivers.robot.modbus.rtu_server import RtuRegisterServer
from slabcell_drivers.robot.modbus.serial_port import SerialSettings
from slabcell_drivers.robot.modbus.tcp_server import TcpRegisterServer
from slabcell_drivers.simulation import World

__all__ = ["CELL_AREAS", "SimulatedPlc", "polled_on_line", "polled_over_tcp"]

CELL_AREAS = frozenset(area for area in Area if not area.written_by_plc)
LOOK_S = 0.2
# How long whoever stands at the robot looks after the cell before pressing START again; twice as long each time.
FIRST_PAUSE_S = 1.0


class SimulatedPlc:
    """One PLC with a robot in a simulated world; ``gripper_at_cell``: the gripper hangs on the cell PC."""

    def __init__(
        self,
        world: World,
        port: RegisterPort,
        register_map: RegisterMap,
        *,
        arm: ArmModel,
        tool: Frame,
        poll_s: float = 0.01,
        timeouts: Timeouts | None = None,
        gripper_at_cell: bool = False,
    ) -> None:
        self.handshake = PlcHandshake(port, register_map, poll_s=poll_s)
        self.body = WorldBody(
            world,
            pick_base=world.scene.table.frame,
            place_base=world.scene.assembly.frame,
            tool=tool,
            arm=arm,
            gripper=CellGripper(self.handshake) if gripper_at_cell else None,
        )
        self.program = JobProgram(self.handshake.ask, self.body, timeouts=timeouts or Timeouts())

    async def run(self, *, starts: int = 1) -> JobEnd:
        """Run the job; START is pressed up to ``starts`` times, each time after a longer pause, if a message stops it.

        A cell that has just been switched on answers at once that its camera is not there yet: 5 starts last 15 s.
        """
        beating = asyncio.create_task(self.handshake.keep_beating(), name="slabcell-plc-watchdog")
        try:
            end = await self.program.run()
            for pressed in range(starts - 1):
                if end.status != "halted":
                    break
                await asyncio.sleep(FIRST_PAUSE_S * 2**pressed)
                end = await self.program.run()
            return end
        finally:
            beating.cancel()
            await asyncio.gather(beating, return_exceptions=True)


@asynccontextmanager
async def polled_over_tcp(
    register_map: RegisterMap, host: str, port: int, started: Callable[[tuple[str, int]], None]
) -> AsyncGenerator[OwnRegisters]:
    """Hold the registers at a TCP port, for a cell that polls; ``started`` is told where.  Raises OSError."""
    image = RegisterImage(register_map, peer_writes=CELL_AREAS)
    server = TcpRegisterServer(image, unit_id=register_map.layout.unit_id, access=Access())
    await server.start(host, port)
    started(server.address)
    try:
        yield OwnRegisters(image)
    finally:
        await server.stop()


@asynccontextmanager
async def polled_on_line(register_map: RegisterMap, settings: SerialSettings) -> AsyncGenerator[OwnRegisters]:
    """Hold the registers at a serial line, for a cell that polls.  Raises OSError."""
    image = RegisterImage(register_map, peer_writes=CELL_AREAS)
    server = RtuRegisterServer(image, settings, unit_id=register_map.layout.unit_id)
    server.open()
    looking = asyncio.create_task(_look(server), name="slabcell-plc-line")
    try:
        yield OwnRegisters(image)
    finally:
        looking.cancel()
        await asyncio.gather(looking, return_exceptions=True)
        server.close()


async def _look(server: RtuRegisterServer) -> None:
    while True:
        server.look_at_time(asyncio.get_running_loop().time())
        await asyncio.sleep(LOOK_S)
