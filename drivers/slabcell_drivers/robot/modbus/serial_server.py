"""How does a PLC reach the cell that polls it over a serial line?  `ModbusRtuServer`: the cell is a unit on the line.

A PLC that says nothing to our unit for ``heartbeat_timeout_s`` counts as lost, and so does one whose watchdog register
stands still after it has moved once.
"""

import asyncio
import time

import structlog

from slabcell_drivers.robot.link_events import EndReason, StateHook, TelegramHook
from slabcell_drivers.robot.link_state import LinkStates
from slabcell_drivers.robot.modbus.access import Counters
from slabcell_drivers.robot.modbus.desk import RequestDesk
from slabcell_drivers.robot.modbus.gripper import PeerGripper
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.register_map import RegisterMap
from slabcell_drivers.robot.modbus.rtu_server import RtuRegisterServer
from slabcell_drivers.robot.modbus.serial_port import SerialSettings
from slabcell_drivers.robot.modbus.server import PLC_AREAS
from slabcell_drivers.robot.protocol import Handler, LinkState

__all__ = ["ModbusRtuServer"]

_log = structlog.get_logger(__name__)


class ModbusRtuServer:
    """A `RobotLink` on a serial line."""

    def __init__(
        self,
        settings: SerialSettings,
        register_map: RegisterMap,
        *,
        heartbeat_timeout_s: float = 3.0,
        reopen_s: float = 1.0,
        gripper: PeerGripper | None = None,
        on_telegram: TelegramHook | None = None,
        on_state: StateHook | None = None,
    ) -> None:
        self._line = settings.url
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._gripper, self._on_telegram = gripper, on_telegram
        self._states = LinkStates("modbus", on_state)
        self._image = RegisterImage(register_map, peer_writes=PLC_AREAS)
        self._server = RtuRegisterServer(
            self._image,
            settings,
            unit_id=register_map.layout.unit_id,
            heard=self._heard,
            lost=lambda: self._lose(EndReason.BROKEN),
            reopen_s=reopen_s,
        )
        self._desk: RequestDesk | None = None
        self._watching: asyncio.Task[None] | None = None
        self._heard_s = 0.0
        self.last_end: EndReason | None = None
        """Why the PLC was lost last."""

    @property
    def state(self) -> LinkState:
        """Where the link stands: connected while a PLC speaks to our unit."""
        return self._states.now

    @property
    def counters(self) -> Counters:
        """What has been served and refused."""
        return self._server.counters

    async def start(self, handler: Handler) -> None:
        """Open the line and serve it; a line that is not there yet is waited for.

        Raises OSError if the line may not be opened or is in use, RuntimeError if already started.
        """
        if self._desk is not None:
            raise RuntimeError("the Modbus server is already started")
        self._desk = desk = RequestDesk(
            self._image,
            handler,
            gripper=self._gripper,
            on_telegram=self._on_telegram,
            failed=lambda: self._lose(EndReason.FAILED),
        )
        try:
            self._server.open()
        except OSError:
            self._desk = None
            raise
        desk.start()
        self._watching = asyncio.get_running_loop().create_task(self._watch(desk), name="slabcell-modbus-line")
        self._states.become(LinkState.LISTENING)

    async def stop(self) -> None:
        """Close the line.  A request under way is finished first.  May be called twice."""
        desk, self._desk = self._desk, None
        if desk is None:
            return
        if self._watching is not None:
            self._watching.cancel()
            await asyncio.gather(self._watching, return_exceptions=True)
        await desk.stop()
        self._server.close()
        self._states.become(LinkState.CLOSED)

    def _heard(self) -> None:
        self._heard_s = time.monotonic()
        if self._states.now is LinkState.LISTENING and self._desk is not None:
            self._desk.new_peer()
            self._states.become(LinkState.CONNECTED)

    def _lose(self, reason: EndReason) -> None:
        if self._states.now is LinkState.CONNECTED:
            self.last_end = reason
            _log.info("modbus.plc_lost", line=self._line, reason=reason.value)
            if self._desk is not None:
                self._desk.new_peer()
            self._states.become(LinkState.LISTENING)

    async def _watch(self, desk: RequestDesk) -> None:
        """Notice a silent PLC, and have a lost line opened again."""
        while True:
            await asyncio.sleep(min(0.25, self._heartbeat_timeout_s / 4))
            now_s = time.monotonic()
            self._server.look_at_time(now_s)
            changed_s = desk.watchdog_changed_s
            alive_s = self._heard_s if changed_s is None else min(self._heard_s, changed_s)
            if now_s - alive_s > self._heartbeat_timeout_s:
                self._lose(EndReason.SILENT)
