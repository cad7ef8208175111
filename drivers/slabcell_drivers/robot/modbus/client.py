"""How does the cell reach a PLC or gateway that holds the registers?  `ModbusClient`: the cell polls, over TCP or RTU.

Only who polls differs: it is still the PLC that asks and the cell that answers, with the same registers.  Each poll
reads what the PLC writes in one request.  An answer goes in two: first the answer area without its toggle, then the
toggle, so that a gateway that copies registers one by one cannot show half an answer as a whole one.

pymodbus carries the requests.  On a serial line a reply carries no number: after a reply that did not come in time the
client waits for what may still come, so that no late reply is taken for the next one's.
"""

import asyncio
import termios
import time
from collections.abc import Awaitable, Callable

import structlog
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from slabcell_drivers.robot.answering import Answering, notice_dead_peer
from slabcell_drivers.robot.link_events import Direction, EndReason, StateHook, TelegramHook
from slabcell_drivers.robot.link_state import LinkStates, pause
from slabcell_drivers.robot.modbus.codec import encode_answer
from slabcell_drivers.robot.modbus.desk import Status, words_to_bytes
from slabcell_drivers.robot.modbus.exchange import Exchange
from slabcell_drivers.robot.modbus.gripper import NoGripper, PeerGripper
from slabcell_drivers.robot.modbus.register_map import Area, RegisterMap
from slabcell_drivers.robot.modbus.serial_port import SerialSettings
from slabcell_drivers.robot.protocol import Answer, Handler, LinkState, Request

__all__ = ["AnyClient", "MakeClient", "ModbusClient", "PollError", "RegisterClient", "serial_client", "tcp_client"]

_log = structlog.get_logger(__name__)

AnyClient = AsyncModbusTcpClient | AsyncModbusSerialClient


class PollError(OSError):
    """A request to the PLC got no answer, or an exception response."""


ConnectHook = Callable[[bool], None]
"""Is told by pymodbus that a connection was made (True) or lost (False)."""

MakeClient = Callable[[ConnectHook], AnyClient]


def tcp_client(host: str, port: int, timeout_s: float) -> MakeClient:
    """Return what makes a client over TCP."""
    return lambda hook: AsyncModbusTcpClient(
        host, port=port, timeout=timeout_s, retries=0, reconnect_delay=0, trace_connect=hook
    )


def serial_client(settings: SerialSettings, timeout_s: float) -> MakeClient:
    """Return what makes a client on a serial line."""
    return lambda hook: AsyncModbusSerialClient(
        settings.url,
        baudrate=settings.baud_rate,
        parity=settings.parity,
        stopbits=settings.stop_bits,
        timeout=timeout_s,
        retries=0,
        reconnect_delay=0,
        trace_connect=hook,
    )


class RegisterClient:
    """Reads and writes words of one unit; every call raises PollError if it fails."""

    def __init__(self, make: MakeClient, register_map: RegisterMap, *, timeout_s: float) -> None:
        self._make = make
        self._map = register_map
        self._timeout_s = timeout_s
        self._client: AnyClient | None = None
        self._lost = asyncio.Event()

    @property
    def connected(self) -> bool:
        """Whether the connection, or the line, is open."""
        return self._client is not None and self._client.connected

    async def connect(self) -> None:
        """Connect anew."""
        self.close()
        self._lost = lost = asyncio.Event()
        client = self._make(lambda connected: None if connected else lost.set())
        try:
            connected = await client.connect()
        except (OSError, termios.error) as error:
            client.close()
            raise PollError(f"no connection: {error}") from error
        if not connected:
            client.close()
            raise PollError("no connection")
        self._client = client
        transport = client.ctx.transport
        sock = transport.get_extra_info("socket") if isinstance(client, AsyncModbusTcpClient) else None
        if sock is not None:
            notice_dead_peer(sock)

    def close(self) -> None:
        """Close the connection; may be called twice."""
        client, self._client = self._client, None
        if client is not None:
            client.close()

    async def read(self, address: int, count: int) -> list[int]:
        """Return words of holding registers."""
        response = await self._ask(
            lambda client: client.read_holding_registers(
                self._map.wire_address(address), count=count, device_id=self._map.layout.unit_id
            )
        )
        if response.isError():
            raise PollError(f"registers {address} to {address + count - 1}: exception {response.exception_code}")
        if len(response.registers) != count:
            raise PollError(f"{len(response.registers)} registers came, {count} were asked for")
        return self._map.from_wire(response.registers)

    async def write(self, address: int, words: list[int]) -> None:
        """Write words to holding registers."""
        response = await self._ask(
            lambda client: client.write_registers(
                self._map.wire_address(address), self._map.to_wire(words), device_id=self._map.layout.unit_id
            )
        )
        if response.isError():
            raise PollError(f"write of {len(words)} registers at {address}: exception {response.exception_code}")

    async def _ask(self, request: Callable[[AnyClient], Awaitable[ModbusPDU]]) -> ModbusPDU:
        """Return the response; pymodbus waits out its timeout when the connection is lost, this does not."""
        client = self._client
        if client is None or not client.connected:
            raise PollError("not connected")
        asking = asyncio.ensure_future(request(client))
        losing = asyncio.ensure_future(self._lost.wait())
        try:
            await asyncio.wait({asking, losing}, return_when=asyncio.FIRST_COMPLETED)
            if not asking.done():
                raise PollError("the connection was lost")
            return asking.result()
        except ModbusException as error:
            if isinstance(client, AsyncModbusSerialClient):
                await asyncio.sleep(self._timeout_s)  # a late reply: pymodbus drops what nobody waits for
            raise PollError(str(error)) from error
        finally:
            for task in (asking, losing):
                task.cancel()
            await asyncio.gather(asking, losing, return_exceptions=True)


class ModbusClient:
    """A `RobotLink` that polls a PLC, again and again until `stop`.

    While the PLC does not answer the state is LISTENING: the link waits for it.
    """

    def __init__(
        self,
        client: RegisterClient,
        register_map: RegisterMap,
        *,
        poll_s: float = 0.01,
        retry_s: float = 1.0,
        heartbeat_timeout_s: float = 3.0,
        gripper: PeerGripper | None = None,
        on_telegram: TelegramHook | None = None,
        on_state: StateHook | None = None,
    ) -> None:
        self._client, self._map = client, register_map
        self._poll_s, self._retry_s, self._heartbeat_timeout_s = poll_s, retry_s, heartbeat_timeout_s
        self._gripper = gripper or NoGripper()
        self._on_telegram = on_telegram
        self._states = LinkStates("modbus", on_state)
        self._stopping = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._exchange = Exchange(register_map)
        self._answering: Answering[Answer] | None = None
        self._pending: asyncio.Task[Answer] | None = None
        self._resumed = False
        self._life: list[int] = []
        self._life_written_s = 0.0
        self._watchdog: int | None = None
        self._watchdog_changed_s: float | None = None
        self._count = 0
        self.failed_polls = 0
        self.last_end: EndReason | None = None
        """Why the PLC was lost last."""

    @property
    def state(self) -> LinkState:
        """Where the link stands now."""
        return self._states.now

    async def start(self, handler: Handler) -> None:
        """Begin to poll; returns at once.  Raises RuntimeError if already started."""
        if self._task is not None:
            raise RuntimeError("the Modbus client is already started")
        self._stopping.clear()
        self._answering = Answering(handler, self._sendable)
        self._states.become(LinkState.LISTENING)
        self._task = asyncio.get_running_loop().create_task(self._keep_polling(), name="slabcell-modbus-client")

    async def stop(self) -> None:
        """Stop polling.  A request under way is finished first.  May be called twice."""
        task, self._task = self._task, None
        if task is None:
            return
        self._stopping.set()
        await task
        if self._pending is not None:
            await asyncio.wait({self._pending})
        self._states.become(LinkState.CLOSED)

    # --------------------------------------------------------------------------------------------------------- polling

    async def _keep_polling(self) -> None:
        while not self._stopping.is_set():
            try:
                await self._client.connect()
                self._life, self._watchdog, self._watchdog_changed_s = [], None, None
                await self._resume()
                self._states.become(LinkState.CONNECTED)
                await self._poll_until_lost()
            except PollError as error:
                _log.debug("modbus.poll_failed", error=str(error))
                self.last_end = EndReason.BROKEN
            except Exception:  # noqa: BLE001 - for example a hook that raises: the link must outlive it
                _log.exception("modbus.client_failed")
                self.last_end = EndReason.FAILED
            self._client.close()
            if self._stopping.is_set():
                self.last_end = EndReason.STOPPED
                break
            self._states.become(LinkState.LISTENING)
            await pause(self._retry_s, unless=self._stopping)

    async def _resume(self) -> None:
        """Take up the handshake where the PLC's memory has it."""
        start, count = self._map.span(Area.ANSWER)
        words = await self._client.read(start, count)
        if not self._exchange.busy:
            self._exchange.resume(words)
        self._resumed = True

    async def _poll_until_lost(self) -> None:
        failing_since_s: float | None = None
        while not self._stopping.is_set():
            began_s = time.monotonic()
            try:
                await self._poll()
                failing_since_s = None
            except PollError as error:
                self.failed_polls += 1
                failing_since_s = failing_since_s or began_s
                if not self._client.connected or time.monotonic() - failing_since_s > self._heartbeat_timeout_s:
                    raise
                _log.debug("modbus.poll_failed", error=str(error))
            changed_s = self._watchdog_changed_s
            if changed_s is not None and time.monotonic() - changed_s > self._heartbeat_timeout_s:
                self.last_end = EndReason.SILENT
                return
            await pause(max(0.0, self._poll_s - (time.monotonic() - began_s)), unless=self._stopping)
        if self._pending is not None:
            await asyncio.wait({self._pending})

    async def _poll(self) -> None:
        if not self._resumed:
            await self._resume()
        life_start, life_count = self._map.span(Area.PLC_LIFE)
        request_start, request_count = self._map.span(Area.REQUEST)
        if life_start + life_count == request_start:
            words = await self._client.read(life_start, life_count + request_count)
            life, request = words[:life_count], words[life_count:]
        else:
            life = await self._client.read(life_start, life_count)
            request = await self._client.read(request_start, request_count)
        self._see_life(life)
        await self._serve(request)
        await self._tell_life()

    async def _serve(self, words: list[int]) -> None:
        if self._pending is None:
            got = self._exchange.take(words)
            if got is None:
                return
            try:
                self._record(Direction.RECEIVED, words)
            except BaseException:
                self._exchange.drop()
                raise
            if isinstance(got, Request):
                self._pending = asyncio.get_running_loop().create_task(self._ask(got), name="slabcell-modbus-request")
                await asyncio.wait({self._pending}, timeout=self._poll_s)
            else:
                await self._show(got, words)
                return
        if self._pending.done():
            answer, self._pending = self._pending.result(), None
            await self._show(answer, words)

    def _sendable(self, answer: Answer) -> Answer:
        """Return an answer that the registers can hold.  Raises ValueError for another."""
        encode_answer(self._map, answer, publication=0, toggle=0)
        return answer

    async def _ask(self, request: Request) -> Answer:
        if self._answering is None:
            raise RuntimeError("the link is not started")
        return await self._answering.answer(request)

    async def _show(self, answer: Answer, request_words: list[int]) -> None:
        words = self._exchange.show(answer, request_words)
        if words is None:
            _log.info("modbus.answer_dropped", sequence=answer.acknowledges)
            return
        start, count = self._map.span(Area.ANSWER)
        self._resumed = False  # if a write fails, what the PLC has is known only once it is read
        await self._client.write(start, words[:-1])
        await self._client.write(start + count - 1, words[-1:])
        self._resumed = True
        self._record(Direction.SENT, words)

    # ------------------------------------------------------------------------------------------------------- liveliness

    def _see_life(self, words: list[int]) -> None:
        start = self._map.span(Area.PLC_LIFE)[0]
        watchdog, command = (
            words[self._map.register(Area.PLC_LIFE, name).address - start] for name in ("watchdog", "io_command")
        )
        if self._watchdog is not None and watchdog != self._watchdog:
            self._watchdog_changed_s = time.monotonic()
        self._watchdog = watchdog
        self._gripper.wish(vacuum=bool(command & 1))

    async def _tell_life(self) -> None:
        """Write the cell's life signs ten times a second, and at once when anything but the watchdog has changed.

        After that look which toggle the PLC has: a gateway may have delivered an earlier write of ours late, over a
        newer one, and then both sides would wait for each other.
        """
        self._count = (self._count + 1) & 0xFFFF
        now_s = time.monotonic()
        status = Status.WORKING if self._pending is not None else Status.WAITING
        signs = [self._watchdog or 0, status, self._gripper.state_bits]
        if signs == self._life and now_s - self._life_written_s < 0.1:
            return
        words = self._map.encode(
            Area.CELL_LIFE,
            {"watchdog": self._count, "watchdog_echo": signs[0], "status": signs[1], "io_state": signs[2]},
        )
        await self._client.write(self._map.span(Area.CELL_LIFE)[0], words)
        self._life, self._life_written_s = signs, now_s
        start, count = self._map.span(Area.ANSWER)
        self._exchange.correct((await self._client.read(start + count - 1, 1))[0])

    def _record(self, direction: Direction, words: list[int]) -> None:
        if self._on_telegram is not None:
            self._on_telegram(direction, words_to_bytes(words), time.monotonic())
