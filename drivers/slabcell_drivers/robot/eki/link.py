"""How does a robot reach the cell over EKI?  `EkiServer`: the TCP server that the controller connects to.

The robot is the TCP client (the role of ``krl/SlabCell.xml``): no port need be opened on the controller, and after a
loss it is the robot that comes back.  One robot at a time.  Who comes second?  A newcomer from the same address is the
robot itself, which has noticed a loss that we have not: it replaces the old connection.  A newcomer from another
address replaces it only if the old one has been silent for ``dead_after_s``; otherwise it is turned away.

A dead peer is noticed by TCP keep-alive (a pulled cable: in two seconds, with no help from the program) and, once
a robot has sent a heartbeat on its connection, by the heartbeat's absence.
"""

import asyncio
import time

import structlog

from slabcell_drivers.robot.answering import HANDLER_FAILED_CODE, Answering, notice_dead_peer
from slabcell_drivers.robot.eki.codec import encode_answer
from slabcell_drivers.robot.eki.connection import Connection
from slabcell_drivers.robot.link_events import Direction, EndReason, StateHook, TelegramHook
from slabcell_drivers.robot.link_state import LinkStates
from slabcell_drivers.robot.protocol import Handler, LinkState

__all__ = ["HANDLER_FAILED_CODE", "Direction", "EkiServer", "EndReason", "TelegramHook"]

_log = structlog.get_logger(__name__)


class EkiServer:
    """A `RobotLink` on a TCP port.

    ``port`` 0 takes a free one; `address` says which.  ``allowed_hosts`` empty means any host.  ``on_telegram`` sees
    every telegram and ``on_state`` every change of state; both are called in the event loop and must not block.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        allowed_hosts: frozenset[str] = frozenset(),
        heartbeat_timeout_s: float = 3.0,
        dead_after_s: float = 3.0,
        on_telegram: TelegramHook | None = None,
        on_state: StateHook | None = None,
    ) -> None:
        self._host, self._port = host, port
        self._allowed_hosts = allowed_hosts
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._dead_after_s = dead_after_s
        self._on_telegram = on_telegram
        self._states = LinkStates("eki", on_state)
        self._server: asyncio.Server | None = None
        self._answering: Answering[bytes] | None = None
        self._current: Connection | None = None
        self._current_host = ""
        self._tasks: set[asyncio.Task[None]] = set()
        self.last_end: EndReason | None = None
        """Why the last connection ended."""
        self.refused = 0
        """How many connections were turned away."""

    @property
    def state(self) -> LinkState:
        """Where the link stands now."""
        return self._states.now

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that the link listens on.  Raises RuntimeError while it does not."""
        if self._server is None:
            raise RuntimeError("the EKI server is not started: call start() first")
        host, port = self._server.sockets[0].getsockname()[:2]
        return str(host), int(port)

    async def start(self, handler: Handler) -> None:
        """Begin to listen.  Raises OSError if the address is taken, RuntimeError if already started."""
        if self._server is not None:
            raise RuntimeError("the EKI server is already started")
        self._answering = Answering(handler, encode_answer)
        self._server = await asyncio.start_server(self._accept, self._host, self._port, backlog=4)
        self._states.become(LinkState.LISTENING)

    async def stop(self) -> None:
        """Close the connection and the port.  A request under way is finished first.  May be called twice."""
        server, self._server = self._server, None
        if server is None:
            return
        server.close()
        if self._current is not None:
            self._current.end(EndReason.STOPPED)
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await server.wait_closed()
        self._states.become(LinkState.CLOSED)

    # ----------------------------------------------------------------------------------------------------- connections

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host = str(writer.get_extra_info("peername")[0])
        answering, refusal = self._answering, self._refusal(host)
        if answering is None or refusal:
            self.refused += 1
            _log.warning("eki.refused", host=host, reason=refusal)
            writer.transport.abort()
            return
        if self._current is not None:
            self._current.end(EndReason.REPLACED)
        connection = Connection(
            reader,
            writer,
            answering.answer,
            heartbeat_timeout_s=self._heartbeat_timeout_s,
            on_telegram=self._on_telegram,
        )
        notice_dead_peer(writer.get_extra_info("socket"))
        self._current, self._current_host = connection, host
        self._states.become(LinkState.CONNECTED)
        task = asyncio.get_running_loop().create_task(self._serve(connection, host))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _refusal(self, host: str) -> str:
        if self._server is None:
            return "the link is being stopped"
        if self._allowed_hosts and host not in self._allowed_hosts:
            return f"only {', '.join(sorted(self._allowed_hosts))} may connect"
        if self._current is not None and host != self._current_host:
            silent_s = time.monotonic() - self._current.last_received_s
            if silent_s < self._dead_after_s:
                return f"{self._current_host} is connected and was heard {silent_s:.1f} s ago"
        return ""

    async def _serve(self, connection: Connection, host: str) -> None:
        _log.info("eki.connected", host=host)
        reason = await connection.run()
        self.last_end = reason
        _log.info("eki.disconnected", host=host, reason=reason.value)
        if self._current is connection:
            self._current = None
            if self._server is not None:
                self._states.become(LinkState.LISTENING)
        await connection.settle()
