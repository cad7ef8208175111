"""How does the cell reach a robot that waits to be connected to?  `EkiClient`, for the reverse role.

The controller is the TCP server (``krl/SlabCellServer.xml``), the cell connects.  Only the direction of the connection
differs: it is still the robot that asks and the cell that answers.  A controller takes one client per channel and
listens only while its program has the channel open, so refusals are the normal case between two runs of the program.
"""

import asyncio

import structlog

from slabcell_drivers.robot.answering import Answering, notice_dead_peer
from slabcell_drivers.robot.eki.codec import encode_answer
from slabcell_drivers.robot.eki.connection import Connection
from slabcell_drivers.robot.link_events import EndReason, StateHook, TelegramHook
from slabcell_drivers.robot.link_state import LinkStates, pause
from slabcell_drivers.robot.protocol import Handler, LinkState

__all__ = ["EkiClient"]

_log = structlog.get_logger(__name__)


class EkiClient:
    """A `RobotLink` that connects to the robot's port, again and again until `stop`.

    While there is no connection the state is LISTENING: the link waits for the robot.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        retry_s: float = 1.0,
        connect_timeout_s: float = 2.0,
        heartbeat_timeout_s: float = 3.0,
        on_telegram: TelegramHook | None = None,
        on_state: StateHook | None = None,
    ) -> None:
        self._host, self._port = host, port
        self._retry_s, self._connect_timeout_s = retry_s, connect_timeout_s
        self._heartbeat_timeout_s = heartbeat_timeout_s
        self._on_telegram = on_telegram
        self._states = LinkStates("eki", on_state)
        self._stopping = asyncio.Event()
        self._current: Connection | None = None
        self._task: asyncio.Task[None] | None = None
        self.last_end: EndReason | None = None
        """Why the last connection ended."""

    @property
    def state(self) -> LinkState:
        """Where the link stands now."""
        return self._states.now

    async def start(self, handler: Handler) -> None:
        """Begin to connect; returns at once.  Raises RuntimeError if already started."""
        if self._task is not None:
            raise RuntimeError("the EKI client is already started")
        self._stopping.clear()
        self._states.become(LinkState.LISTENING)
        self._task = asyncio.get_running_loop().create_task(self._keep_connected(Answering(handler, encode_answer)))

    async def stop(self) -> None:
        """Close the connection.  A request under way is finished first.  May be called twice."""
        task, self._task = self._task, None
        if task is None:
            return
        self._stopping.set()
        if self._current is not None:
            self._current.end(EndReason.STOPPED)
        await task
        self._states.become(LinkState.CLOSED)

    async def _keep_connected(self, answering: Answering[bytes]) -> None:
        while not self._stopping.is_set():
            try:
                reader, writer = await self._connect()
            except OSError as error:  # TimeoutError is one
                _log.debug("eki.no_robot", host=self._host, port=self._port, error=repr(error))
            else:
                await self._serve(reader, writer, answering)
            await pause(self._retry_s, unless=self._stopping)

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        """Connect, unless the link is stopped first (ConnectionAbortedError)."""
        connecting = asyncio.ensure_future(
            asyncio.wait_for(asyncio.open_connection(self._host, self._port), self._connect_timeout_s)
        )
        stopping = asyncio.ensure_future(self._stopping.wait())
        try:
            await asyncio.wait({connecting, stopping}, return_when=asyncio.FIRST_COMPLETED)
            if connecting.done():
                return connecting.result()
            raise ConnectionAbortedError("the link is being stopped")
        finally:
            for task in (connecting, stopping):
                task.cancel()
            await asyncio.gather(connecting, stopping, return_exceptions=True)

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, answering: Answering[bytes]
    ) -> None:
        notice_dead_peer(writer.get_extra_info("socket"))
        connection = self._current = Connection(
            reader,
            writer,
            answering.answer,
            heartbeat_timeout_s=self._heartbeat_timeout_s,
            on_telegram=self._on_telegram,
        )
        if self._stopping.is_set():
            connection.end(EndReason.STOPPED)
        self._states.become(LinkState.CONNECTED)
        self.last_end = await connection.run()
        self._current = None
        _log.info("eki.disconnected", host=self._host, reason=self.last_end.value)
        if not self._stopping.is_set():
            self._states.become(LinkState.LISTENING)
        await connection.settle()
