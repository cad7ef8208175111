"""What can go wrong between a PLC and the cell, done on purpose: on the wire, in the registers, by the slave."""

import asyncio
import contextlib
import random
from collections import Counter
from collections.abc import AsyncGenerator, Callable

from slabcell_drivers.robot.modbus.client import PollError
from slabcell_drivers.robot.modbus.image import ExceptionCode, RefusedError
from slabcell_drivers.robot.modbus.register_map import Area, RegisterMap

KINDS = ("cut", "delay", "duplicate", "stale toggle", "half-written", "slave exception")
ON_THE_WIRE = ("cut", "delay", "duplicate")


class Faults:
    """Which fault comes when: each at a random point of its own way, ``budget`` of them in a job."""

    def __init__(self, seed: int, *, budget: int) -> None:
        self.random = random.Random(seed)
        self._left = budget
        self._next_in = self.random.randrange(1, 30)
        self.done: Counter[str] = Counter()
        self.cut: Callable[[], None] = lambda: None
        self.deaf = 0
        """So many deliveries of the wire are still to be lost."""

    def due(self, *kinds: str) -> str:
        """Return a fault that comes now, out of those that are possible here; nothing otherwise."""
        if self._left == 0:
            return ""
        self._next_in -= 1
        if self._next_in > 0:
            return ""
        kind = self.random.choice(kinds)
        self._left -= 1
        self._next_in = self.random.randrange(1, 60)
        self.done[kind] += 1
        return kind

    def wire(self, _end: int, data: bytes, deliver: Callable[[bytes], None]) -> None:
        """Disturb what passes over a wire, one delivery of which is about one frame."""
        if self.deaf:
            self.deaf -= 1
            return
        later = asyncio.get_running_loop().call_later
        match self.due(*ON_THE_WIRE):
            case "cut":
                deliver(data[: self.random.randrange(len(data) + 1)])
                self.deaf = self.random.randrange(1, 4)
                self.cut()
            case "delay":
                later(self.random.uniform(0.01, 0.3), deliver, data)
            case "duplicate":
                deliver(data)
                later(self.random.uniform(0.0, 0.05), deliver, data)
            case _:
                deliver(data)


class FaultyStore:
    """A slave that refuses a request now and then."""

    def __init__(self, store, faults: Faults) -> None:
        self._store, self._faults = store, faults

    def __getattr__(self, name: str):
        call = getattr(self._store, name)

        def maybe(*values):
            if self._faults.due("slave exception"):
                raise RefusedError(
                    self._faults.random.choice([ExceptionCode.DEVICE_BUSY, ExceptionCode.DEVICE_FAILURE])
                )
            return call(*values)

        return maybe


class FaultyPort:
    """The PLC's way to the registers, through a gateway that copies when and what it likes."""

    def __init__(self, port, register_map: RegisterMap, faults: Faults) -> None:
        self._port, self._map, self._faults = port, register_map, faults
        self._requests: list[list[int]] = []
        self._answer: list[int] = []

    @property
    def connected(self) -> bool:
        return self._port.connected

    async def connect(self) -> None:
        await self._port.connect()

    async def read(self, address: int, count: int) -> list[int]:
        start, whole = self._map.span(Area.ANSWER)
        words = await self._port.read(address, count)
        if start <= address < start + whole:
            old = self._answer[address - start : address - start + count]
            self._answer[address - start : address - start + count] = words
            if old and old != words and self._faults.due("half-written"):
                at = self._faults.random.randrange(count + 1)
                return self._faults.random.choice([old[:at] + words[at:], words[:at] + old[at:]])
        return words

    async def write(self, address: int, words: list[int]) -> None:
        start, count = self._map.span(Area.REQUEST)
        if address == start + count - 1:
            await self._write_toggle(address, words)
            return
        if address == start and self._faults.due("half-written"):
            at = self._faults.random.randrange(len(words))
            await self._port.write(address, words[:at])
            await self._port.write(start + count - 1, [self._faults.random.randrange(2)])  # before the rest
            if self._faults.random.random() < 0.5:
                raise PollError("the gateway lost the rest")
            await asyncio.sleep(self._faults.random.uniform(0.0, 0.03))
        await self._port.write(address, words)

    async def _write_toggle(self, address: int, words: list[int]) -> None:
        start, count = self._map.span(Area.REQUEST)
        if self._requests and self._faults.due("stale toggle"):
            stale = self._faults.random.choice(self._requests)
            now = await self._port.read(start, count)
            await self._port.write(start, stale)
            await asyncio.sleep(self._faults.random.uniform(0.0, 0.05))
            await self._port.write(start, now[:-1])
        await self._port.write(address, words)
        with contextlib.suppress(OSError):
            self._requests = [*self._requests[-9:], await self._port.read(start, count)]


class TcpProxy:
    """A wire between two TCP ends that can be disturbed and cut."""

    def __init__(self, target: tuple[str, int], faults: Faults) -> None:
        self._target, self._faults = target, faults
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    @classmethod
    @contextlib.asynccontextmanager
    async def running(cls, target: tuple[str, int], faults: Faults) -> AsyncGenerator[tuple[str, int]]:
        proxy = cls(target, faults)
        faults.cut = proxy.cut
        proxy._server = await asyncio.start_server(proxy._accept, "127.0.0.1", 0)
        try:
            yield proxy._server.sockets[0].getsockname()[:2]
        finally:
            proxy._server.close()
            while proxy._tasks:
                proxy.cut()
                await asyncio.gather(*proxy._tasks, return_exceptions=True)

    def cut(self) -> None:
        for writer in tuple(self._writers):
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._writers.add(writer)
        try:
            far_reader, far_writer = await asyncio.open_connection(*self._target)
        except OSError:
            writer.transport.abort()
            self._writers.discard(writer)
            return
        self._writers.add(far_writer)
        await asyncio.gather(self._pump(0, reader, far_writer), self._pump(1, far_reader, writer))
        for end in (writer, far_writer):
            end.transport.abort()
            self._writers.discard(end)
            with contextlib.suppress(OSError):
                await end.wait_closed()

    async def _pump(self, end: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        def deliver(data: bytes) -> None:
            if data and not writer.transport.is_closing():
                writer.write(data)

        with contextlib.suppress(OSError):
            while data := await reader.read(4096):
                self._faults.wire(end, data, deliver)
        writer.transport.abort()
