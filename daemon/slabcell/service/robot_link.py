"""How does the robot reach the cell?  The link that the configuration means, served for as long as a block lasts."""

from __future__ import annotations

import asyncio
import contextlib
import errno
from collections.abc import AsyncGenerator

import structlog

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

STOP_TIMEOUT_S = 1.0
"""So long the robot's request under way may take when the cell stops; nobody is told its answer any more."""
ADDRESS_EVERY_S = 1.0

_log = structlog.get_logger(__name__)


@contextlib.asynccontextmanager
async def serve_robot(config: CellConfig, robot: RobotWatch, alarms: Alarms) -> AsyncGenerator[tuple[str, int]]:
    """Serve the robot; gives the address at which both meet, port 0 for a serial line.

    An address that this PC does not have yet is waited for.  Raises ConfigurationError, or UnavailableError if the
    address is taken.
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
            if error.errno == errno.EADDRNOTAVAIL:
                await stack.enter_async_context(_started_later(link, handler, robot, where))
                yield where
                return
            section = "eki" if config.robot.link == "eki" else "modbus"
            host, port = where
            place = f"{host}:{port}" if port else host
            msg = (
                f"[robot.{section}] {place} cannot be listened on: {error.strerror or error};"
                " is it this PC's own, and not in use?"
            )
            raise UnavailableError(msg) from error
        where = _met(link, robot, where)
        try:
            yield where
        finally:
            await _stop(link)


async def _stop(link: RobotLink) -> None:
    try:
        async with asyncio.timeout(STOP_TIMEOUT_S):
            await link.stop()
    except TimeoutError:
        _log.warning("the robot's request did not end in time", limit_s=STOP_TIMEOUT_S)


def _met(link: RobotLink, robot: RobotWatch, where: tuple[str, int]) -> tuple[str, int]:
    if isinstance(link, EkiServer | ModbusTcpServer):
        where = link.address
    robot.meets_at(*where, link)
    return where


@contextlib.asynccontextmanager
async def _started_later(
    link: RobotLink, handler: Handler, robot: RobotWatch, where: tuple[str, int]
) -> AsyncGenerator[None]:
    """Serve the robot as soon as this PC has the address: its network may come up after the daemon."""
    waiting = asyncio.create_task(_start_when_there(link, handler, robot, where), name="slabcell-robot-address")
    try:
        yield
    finally:
        waiting.cancel()
        await asyncio.gather(waiting, return_exceptions=True)
        await _stop(link)


async def _start_when_there(link: RobotLink, handler: Handler, robot: RobotWatch, where: tuple[str, int]) -> None:
    host, port = where
    _log.warning("the robot's address is not there yet", host=host, port=port, next_try_s=ADDRESS_EVERY_S)
    while True:
        try:
            await link.start(handler)
        except OSError as error:
            robot.unreachable(f"{host}:{port} is not this PC's address yet: {error.strerror or error}")
            await asyncio.sleep(ADDRESS_EVERY_S)
        else:
            _met(link, robot, where)
            return


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
            return make_modbus_link("modbus-tcp", modbus, gripper, robot.link_changed, robot.telegram), (
                modbus.host,
                modbus.port,
            )
        case "modbus-rtu":
            return make_modbus_link("modbus-rtu", modbus, gripper, robot.link_changed, robot.telegram), (
                modbus.device,
                0,
            )


@contextlib.asynccontextmanager
async def _polled(gripper: ModbusGripper) -> AsyncGenerator[None]:
    polling = asyncio.create_task(gripper.run(), name="slabcell-gripper")
    try:
        yield
    finally:
        polling.cancel()
        await asyncio.gather(polling, return_exceptions=True)
