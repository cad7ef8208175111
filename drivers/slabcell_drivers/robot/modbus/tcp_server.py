"""How is a register image served over TCP?  `TcpRegisterServer`: peers in, requests answered, everything bounded.

pymodbus has a server too; it cannot refuse peers, limit connections or end a connection by rule, and it drops the first
of two requests that arrive together (docs/decisions).  Here every request is answered in the call that delivers it, so
that a busy cell delays no poll.

A connection ends when its peer closes it; at a header that cannot be right; when a frame stays incomplete for two
seconds; after sixteen refused requests in a row; when more requests arrive at once than a peer in lock-step sends; when
the peer does not read its answers; and when it says nothing for the idle time.
"""

import asyncio
import time
from collections.abc import Callable

import structlog

from slabcell_drivers.robot.answering import notice_dead_peer
from slabcell_drivers.robot.link_events import EndReason
from slabcell_drivers.robot.modbus.access import Access, Counters
from slabcell_drivers.robot.modbus.framing import FramingError, ModbusFrame, TcpFramer, tcp_frame
from slabcell_drivers.robot.modbus.image import ExceptionCode
from slabcell_drivers.robot.modbus.pdu import Store, answer_pdu

__all__ = ["PeerConnection", "TcpRegisterServer"]

MAX_AT_ONCE = 16
MAX_REFUSED_IN_A_ROW = 16
MAX_UNREAD_BYTES = 64 * 1024
FRAME_TIMEOUT_S = 2.0
LOOK_EVERY_S = 0.5
_ANY_UNIT = (0, 255)
"""Over TCP these mean the device at this address (MODBUS messaging on TCP/IP V1.0b, 4.4.2.2)."""

_log = structlog.get_logger(__name__)


class PeerConnection(asyncio.Protocol):
    """One peer."""

    def __init__(self, server: "TcpRegisterServer") -> None:
        self._server = server
        self._framer = TcpFramer()
        self._refused_in_a_row = 0
        self._incomplete_since_s: float | None = None
        self._transport: asyncio.Transport | None = None
        self.host = ""
        self.last_received_s = time.monotonic()
        self.end_reason: EndReason | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the peer, or turn it away."""
        assert isinstance(transport, asyncio.Transport)  # noqa: S101 - what asyncio gives to a stream's protocol
        self._transport = transport
        self.host = str((transport.get_extra_info("peername") or ("?",))[0])
        if self._server.admit(self):
            notice_dead_peer(transport.get_extra_info("socket"))
        else:
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the server."""
        if self.end_reason is None:
            self.end_reason = EndReason.PEER_CLOSED if exc is None else EndReason.BROKEN
        self._server.leave(self)

    def data_received(self, data: bytes) -> None:
        """Answer the requests that are complete now."""
        if self._transport is None or self.end_reason is not None:
            return
        self.last_received_s = time.monotonic()
        try:
            frames = self._framer.feed(data)
        except FramingError as error:
            self._server.counters.malformed += 1
            _log.warning("modbus.malformed", host=self.host, error=str(error))
            self.end(EndReason.GARBAGE)
            return
        if len(frames) > MAX_AT_ONCE:
            self.end(EndReason.FLOODED)
            return
        for frame in frames:
            if self.end_reason is None:
                self._transport.write(tcp_frame(self._answer(frame)))
        self._incomplete_since_s = self.last_received_s if self._framer.pending else None
        if self._transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            self.end(EndReason.NOT_READING)
        elif self._refused_in_a_row >= MAX_REFUSED_IN_A_ROW:
            self._server.counters.malformed += 1
            self.end(EndReason.GARBAGE)

    def _answer(self, frame: ModbusFrame) -> ModbusFrame:
        pdu = self._server.answer(self, frame)
        self._refused_in_a_row = self._refused_in_a_row + 1 if pdu[0] & 0x80 else 0
        return ModbusFrame(frame.unit, frame.transaction, pdu)

    def look_at_time(self, now_s: float, idle_timeout_s: float) -> None:
        """End the connection if something has been due for too long."""
        if self._incomplete_since_s is not None and now_s - self._incomplete_since_s > FRAME_TIMEOUT_S:
            self._server.counters.malformed += 1
            self.end(EndReason.GARBAGE)
        elif now_s - self.last_received_s > idle_timeout_s:
            self.end(EndReason.SILENT)

    def end(self, reason: EndReason) -> None:
        """Close the connection; the first reason counts."""
        if self.end_reason is None:
            self.end_reason = reason
            if self._transport is not None:
                stuck = reason is EndReason.NOT_READING or self._transport.get_write_buffer_size() > 0
                self._transport.abort() if stuck else self._transport.close()


class TcpRegisterServer:
    """Serves a store on one port.

    ``may_write`` is asked before each write of a connection; ``left`` is told of each connection that ended.
    """

    def __init__(
        self,
        store: Store,
        *,
        unit_id: int,
        access: Access,
        may_write: Callable[[PeerConnection], bool] = lambda _connection: True,
        left: Callable[[PeerConnection], None] = lambda _connection: None,
    ) -> None:
        self.counters = Counters()
        self.connections: set[PeerConnection] = set()
        self._store = store
        self._units = (unit_id, *_ANY_UNIT)
        self._access = access
        self._may_write, self._left = may_write, left
        self._server: asyncio.Server | None = None
        self._looking: asyncio.Task[None] | None = None
        self._all_left = asyncio.Event()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that the server listens on.  Raises RuntimeError while it does not."""
        if self._server is None:
            raise RuntimeError("the Modbus server is not started: call start() first")
        host, port = self._server.sockets[0].getsockname()[:2]
        return str(host), int(port)

    async def start(self, host: str, port: int) -> None:
        """Begin to listen.  Raises OSError if the address is taken."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: PeerConnection(self), host, port, backlog=4)
        self._looking = loop.create_task(self._look_at_time(), name="slabcell-modbus-idle")

    async def stop(self) -> None:
        """Close the port and every connection; no task or socket is left behind.  May be called twice."""
        server, self._server = self._server, None
        if server is None:
            return
        server.close()
        if self._looking is not None:
            self._looking.cancel()
            await asyncio.gather(self._looking, return_exceptions=True)
        for connection in tuple(self.connections):
            connection.end(EndReason.STOPPED)
        while self.connections:
            self._all_left.clear()
            await self._all_left.wait()
        await server.wait_closed()

    # ------------------------------------------------------------------------------------- called by the connections

    def admit(self, connection: PeerConnection) -> bool:
        """Take a connection, or count why not."""
        if self._server is None or not self._access.allows(connection.host):
            self.counters.refused_peers += 1
            _log.warning("modbus.refused", host=connection.host, reason="not on the list of peers")
            return False
        if len(self.connections) >= self._access.max_connections:
            self.counters.refused_limit += 1
            _log.warning("modbus.refused", host=connection.host, reason=f"{self._access.max_connections} are connected")
            return False
        self.counters.connections += 1
        self.connections.add(connection)
        return True

    def leave(self, connection: PeerConnection) -> None:
        """Forget a connection."""
        if connection in self.connections:
            self.connections.discard(connection)
            self._left(connection)
        if not self.connections:
            self._all_left.set()

    def answer(self, connection: PeerConnection, frame: ModbusFrame) -> bytes:
        """Return the response to one request."""
        self.counters.requests += 1
        if frame.unit in self._units:
            pdu = answer_pdu(self._store, frame.pdu, lambda: self._asked_to_write(connection))
        else:
            pdu = bytes((frame.pdu[0] | 0x80, ExceptionCode.NO_SUCH_UNIT))
        self.counters.exceptions += pdu[0] >> 7
        return pdu

    def _asked_to_write(self, connection: PeerConnection) -> bool:
        allowed = self._may_write(connection)
        self.counters.refused_writes += not allowed
        return allowed

    async def _look_at_time(self) -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            now_s = time.monotonic()
            for connection in tuple(self.connections):
                connection.look_at_time(now_s, self._access.idle_timeout_s)
