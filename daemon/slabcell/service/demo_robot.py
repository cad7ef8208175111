"""Who lays the slabs in a demo, and over which link?  The shipped KRL over EKI, or a PLC in software over Modbus."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from slabcell.service.config import CellConfig
from slabcell.service.modbus_config import shipped_map
from slabcell.service.simulated import SimulatedCell
from slabcell_drivers.krc import RunResult, SoftwareKrc
from slabcell_drivers.plc.pty_pair import PtyPair
from slabcell_drivers.plc.simulated import SimulatedPlc
from slabcell_drivers.robot import Frame, Handler, RobotLink
from slabcell_drivers.robot.arm import ArmModel
from slabcell_drivers.robot.eki.link import EkiServer
from slabcell_drivers.robot.modbus import (
    Access,
    ModbusRtuServer,
    ModbusTcpServer,
    RegisterClient,
    RegisterMap,
    SerialSettings,
    serial_client,
    tcp_client,
)

__all__ = ["DemoLink", "DemoRobot", "demo_robot"]

PROGRAM = "SlabCell"
JOB_TIMEOUT_S = 240.0
POLL_TIMEOUT_S = 2.0
PTY_BAUD = 115_200


class DemoLink(StrEnum):
    """How robot and cell speak in a demo."""

    EKI = "eki"
    MODBUS_TCP = "modbus-tcp"
    MODBUS_RTU = "modbus-rtu"


class DemoRobot(Protocol):
    """A robot that runs one job."""

    @property
    def program(self) -> str:
        """Name of what it runs."""
        ...

    @property
    def messages(self) -> tuple[str, ...]:
        """What it showed on its display."""
        ...

    async def run(self) -> RunResult:
        """Run the job to its end."""
        ...


@asynccontextmanager
async def demo_robot(
    kind: DemoLink, simulated: SimulatedCell, config: CellConfig, arm: ArmModel, handler: Handler, seed: int
) -> AsyncGenerator[DemoRobot]:
    """Give a robot whose link to the cell stands.  Raises OSError if an address is taken."""
    tool = config.robot.tool.to_frame()
    async with AsyncExitStack() as stack:
        if kind is DemoLink.EKI:
            server = EkiServer(config.robot.eki.host, config.robot.eki.port)
            await stack.enter_async_context(_serving(server, handler))
            yield _Krc(stack.enter_context(simulated.controller(server.address, seed=seed)))
            return
        register_map = shipped_map()
        if kind is DemoLink.MODBUS_TCP:
            link = ModbusTcpServer("127.0.0.1", 0, register_map, access=Access(["127.0.0.1"]))
            await stack.enter_async_context(_serving(link, handler))
            make = tcp_client(*link.address, POLL_TIMEOUT_S)
        else:
            line = await stack.enter_async_context(PtyPair())
            ours, theirs = (SerialSettings(end, PTY_BAUD, "N") for end in line.ends)
            await stack.enter_async_context(_serving(ModbusRtuServer(ours, register_map), handler))
            make = serial_client(theirs, POLL_TIMEOUT_S)
        port = RegisterClient(make, register_map, timeout_s=POLL_TIMEOUT_S)
        stack.callback(port.close)
        yield _Plc(simulated, port, register_map, arm, tool)


@asynccontextmanager
async def _serving(link: RobotLink, handler: Handler) -> AsyncGenerator[None]:
    await link.start(handler)
    try:
        yield
    finally:
        await link.stop()


@dataclass(frozen=True, slots=True)
class _Krc:
    """The software KRC with the shipped programs, in a thread of its own."""

    controller: SoftwareKrc
    program: str = PROGRAM

    @property
    def messages(self) -> tuple[str, ...]:
        return tuple(str(message) for message in self.controller.messages)

    async def run(self) -> RunResult:
        running = asyncio.create_task(
            asyncio.to_thread(self.controller.run, PROGRAM, max_wall_s=JOB_TIMEOUT_S), name="krc"
        )
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            self.controller.cancel()
            await running
            raise


class _Plc:
    """The PLC in software, in the event loop."""

    program = "PLC"

    def __init__(
        self, simulated: SimulatedCell, port: RegisterClient, register_map: RegisterMap, arm: ArmModel, tool: Frame
    ) -> None:
        self._plc = SimulatedPlc(simulated.world, port, register_map, arm=arm, tool=tool)

    @property
    def messages(self) -> tuple[str, ...]:
        return tuple(self._plc.program.messages)

    async def run(self) -> RunResult:
        async with asyncio.timeout(JOB_TIMEOUT_S):
            end = await self._plc.run()
        return RunResult(end.status, 0, end.message, "", 0, 0.0, end.requests)
