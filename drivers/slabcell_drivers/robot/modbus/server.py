"""How does a PLC reach the cell that polls it over TCP?  `ModbusTcpServer`: the registers are here, the PLC comes.

Any peer on the list may read.  One peer at a time writes: the first that does.  Who comes second?  A peer from the same
address is the PLC itself, which has noticed a loss that we have not: it takes the other's place.  A peer from another
address does so only if the first has been silent for ``dead_after_s``; until then its writes are refused as busy.

A dead peer is noticed by TCP keep-alive (a pulled cable: in two seconds) and, once the PLC has changed its watchdog
register, by its standing still.
"""

import asyncio
import time

import structlog

from slabcell_drivers.robot.link_events import EndReason, StateHook, TelegramHook
from slabcell_drivers.robot.link_state import LinkStates
from slabcell_drivers.robot.modbus.access import Access, Counters
from slabcell_drivers.robot.modbus.desk import RequestDesk
from slabcell_drivers.robot.modbus.gripper import PeerGripper
from slabcell_drivers.robot.modbus.image import RegisterImage
from slabcell_drivers.robot.modbus.register_map import Area, RegisterMap
from slabcell_drivers.robot.modbus.tcp_server import PeerConnection, TcpRegisterServer
from slabcell_drivers.robot.protocol import Handler, LinkState

__all__ = ["PLC_AREAS", "ModbusTcpServer"]

PLC_AREAS = frozenset(area for area in Area if area.written_by_plc)

_log = structlog.get_logger(__name__)


class ModbusTcpServer:
    """A `RobotLink` on a TCP port; ``port`` 0 takes a free one, and `address` says which."""

    def __init__(
        self,
        host: str,
        port: int,
        register_map: RegisterMap,
        *,
        access: Access | None = None,
        heartbeat_timeout_s: float = 3.0,
        dead_after_s: float = 3.0,
        gripper: PeerGripper | None = None,
        on_telegram: TelegramHook | None = None,
        on_state: StateHook | None = None,
    ) -> None:
        self._host, self._port = host, port
        self._heartbeat_timeout_s, self._dead_after_s = heartbeat_timeout_s, dead_after_s
        self._gripper, self._on_telegram = gripper, on_telegram
        self._states = LinkStates("modbus", on_state)
        self._image = RegisterImage(register_map, peer_writes=PLC_AREAS)
        self._server = TcpRegisterServer(
            self._image,
            unit_id=register_map.layout.unit_id,
            access=access or Access(),
            may_write=self._may_write,
            left=self._left,
        )
        self._desk: RequestDesk | None = None
        self._writer: PeerConnection | None = None
        self._watching: asyncio.Task[None] | None = None
        self.last_end: EndReason | None = None
        """Why the last connection of a PLC ended."""

    @property
    def state(self) -> LinkState:
        """Where the link stands: connected while a peer that writes is there."""
        return self._states.now

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that the link listens on.  Raises RuntimeError while it does not."""
        return self._server.address

    @property
    def counters(self) -> Counters:
        """What has been served and refused."""
        return self._server.counters

    async def start(self, handler: Handler) -> None:
        """Begin to listen.  Raises OSError if the address is taken, RuntimeError if already started."""
        if self._desk is not None:
            raise RuntimeError("the Modbus server is already started")
        desk = RequestDesk(
            self._image, handler, gripper=self._gripper, on_telegram=self._on_telegram, failed=self._hook_failed
        )
        await self._server.start(self._host, self._port)
        self._desk = desk
        desk.start()
        self._watching = asyncio.get_running_loop().create_task(self._watch(desk), name="slabcell-modbus-silence")
        self._states.become(LinkState.LISTENING)

    async def stop(self) -> None:
        """Close connections and port.  A request under way is finished first.  May be called twice."""
        desk, self._desk = self._desk, None
        if desk is None:
            return
        if self._watching is not None:
            self._watching.cancel()
            await asyncio.gather(self._watching, return_exceptions=True)
        await desk.stop()
        await self._server.stop()
        self._states.become(LinkState.CLOSED)

    # --------------------------------------------------------------------------------------------------- who may write

    def _may_write(self, connection: PeerConnection) -> bool:
        writer = self._writer
        if writer is connection:
            return True
        if self._desk is None:
            return False
        if writer is not None:
            silent_s = time.monotonic() - writer.last_received_s
            if connection.host != writer.host and silent_s < self._dead_after_s:
                return False
            writer.end(EndReason.REPLACED)
            self.last_end = EndReason.REPLACED
        self._writer = connection
        self._desk.new_peer()
        _log.info("modbus.writer", host=connection.host)
        self._states.become(LinkState.CONNECTED)
        return True

    def _left(self, connection: PeerConnection) -> None:
        if connection is not self._writer:
            return
        self._writer = None
        self.last_end = connection.end_reason
        _log.info("modbus.writer_left", host=connection.host, reason=str(connection.end_reason))
        if self._desk is not None:
            self._states.become(LinkState.LISTENING)

    def _hook_failed(self) -> None:
        if self._writer is not None:
            self._writer.end(EndReason.FAILED)

    async def _watch(self, desk: RequestDesk) -> None:
        """End the PLC's connection when its watchdog stands still."""
        while True:
            await asyncio.sleep(min(0.25, self._heartbeat_timeout_s / 4))
            changed_s = desk.watchdog_changed_s
            if changed_s is not None and time.monotonic() - changed_s > self._heartbeat_timeout_s:
                desk.new_peer()
                if self._writer is not None:
                    self._writer.end(EndReason.SILENT)
