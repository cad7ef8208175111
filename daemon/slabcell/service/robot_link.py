"""How does the robot reach the cell?  The link that the configuration means, served for as long as a block lasts."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator

from slabcell.cell.alarms import Alarms
from slabcell.errors import UnavailableError
from slabcell.service.config import CellConfig
from slabcell.service.gripper_guard import GripperGuard
from slabcell.service.modbus_config import make_gripper, make_modbus_link
from slabcell.service.robot_watch import RobotWatch
from slabcell_drivers.robot import Handler, RobotLink
from slabcell_drivers.robot.eki.client import EkiClient
from slabcell_drivers.robot.eki.link import EkiServer
from slabcell_drivers.robot.modbus import ModbusGripper, ModbusTcpServer

__all__ = ["serve_robot"]

STOP_TIMEOUT_S = 5.0


@contextlib.asynccontextmanager
async def serve_robot(config: CellConfig, robot: RobotWatch, alarms: Alarms) -> AsyncGenerator[tuple[str, int]]:
    """Serve the robot; gives the address at which both meet, port 0 for a serial line.

    Raises ConfigurationError, or UnavailableError if the address is taken.
    """
    async with contextlib.AsyncExitStack() as stack:
        gripper_config = config.robot.modbus.gripper
        gripper: ModbusGripper | None = None
        handler: Handler = robot.handle
        if config.robot.link != "eki" and gripper_config is not None:
            gripper = make_gripper(gripper_config)
            handler = GripperGuard(gripper, alarms, robot.handle).handle
            await stack.enter_async_context(_polled(gripper))
        link, where = _make(config, robot, gripper)
        try:
            await link.start(handler)
        except OSError as error:
            section = "eki" if config.robot.link == "eki" else "modbus"
            host, port = where
            place = f"{host}:{port}" if port else host
            msg = (
                f"[robot.{section}] {place} cannot be listened on: {error.strerror or error};"
                " is it this PC's own, and not in use?"
            )
            raise UnavailableError(msg) from error
        if isinstance(link, EkiServer | ModbusTcpServer):
            where = link.address
        robot.meets_at(*where, link)
        try:
            yield where
        finally:
            async with asyncio.timeout(STOP_TIMEOUT_S):
                await link.stop()


def _make(config: CellConfig, robot: RobotWatch, gripper: ModbusGripper | None) -> tuple[RobotLink, tuple[str, int]]:
    krl, eki, modbus = config.robot.krl, config.robot.eki, config.robot.modbus
    match config.robot.link:
        case "eki" if krl.robot_connects:
            link = EkiServer(eki.host, eki.port, on_state=robot.link_changed, on_telegram=robot.telegram)
            return link, (eki.host, eki.port)
        case "eki":
            address = (krl.robot_ip, krl.robot_port)
            return EkiClient(*address, on_state=robot.link_changed, on_telegram=robot.telegram), address
        case "modbus-tcp":
            return make_modbus_link("modbus-tcp", modbus, gripper, robot.link_changed), (modbus.host, modbus.port)
        case "modbus-rtu":
            return make_modbus_link("modbus-rtu", modbus, gripper, robot.link_changed), (modbus.device, 0)


@contextlib.asynccontextmanager
async def _polled(gripper: ModbusGripper) -> AsyncGenerator[None]:
    polling = asyncio.create_task(gripper.run(), name="slabcell-gripper")
    try:
        yield
    finally:
        polling.cancel()
        await asyncio.gather(polling, return_exceptions=True)
