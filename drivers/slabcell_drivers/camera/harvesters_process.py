"""How is the process that holds Harvesters started, asked and ended?  One process, its socket, its shared memory."""

import asyncio
import contextlib
import json
import mmap
import os
import socket
import sys
from typing import Any, Final

import numpy as np

from slabcell_drivers.camera import protocol
from slabcell_drivers.camera.harvesters_child import SHARED_BYTES
from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS, decode_pixels
from slabcell_drivers.camera.protocol import CameraError, CameraInfo, CameraLost, Pixels

__all__ = ["HarvestersProcess"]

_CHILD: Final = "slabcell_drivers.camera.harvesters_child"
_LAST_WORDS_BYTES: Final = 400


class HarvestersProcess:
    """The process, its socket, and the memory that it shares with us.  Make it with `start`."""

    def __init__(self, name: str) -> None:
        self.counts: dict[str, int | float] = {}
        """The child's statistics, as they came with its newest answer."""
        self._name = name
        self._memory_fd = os.memfd_create("slabcell-frame", os.MFD_CLOEXEC)
        os.ftruncate(self._memory_fd, SHARED_BYTES)
        self._memory = mmap.mmap(self._memory_fd, SHARED_BYTES, prot=mmap.PROT_READ)
        self._last_words = b""
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._number = 0
        self._process: asyncio.subprocess.Process | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._writer: asyncio.StreamWriter | None = None

    @classmethod
    async def start(cls, name: str) -> "HarvestersProcess":
        """Start a process for the camera of this name."""
        child = cls(name)
        ours, theirs = socket.socketpair()
        try:
            process = child._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", _CHILD, str(theirs.fileno()), str(child._memory_fd),
                stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
                pass_fds=(theirs.fileno(), child._memory_fd),
            )  # fmt: skip
        except BaseException:
            ours.close()
            await child.end()
            raise
        finally:
            theirs.close()
        reader, child._writer = await asyncio.open_connection(sock=ours)
        child._tasks = [
            asyncio.create_task(child._read(reader), name=f"harvesters {name}"),
            asyncio.create_task(child._listen(process.stdout), name=f"harvesters {name} output"),
        ]
        return child

    @property
    def process_id(self) -> int | None:
        """Its process id, None once it was ended."""
        return self._process.pid if self._process else None

    @property
    def alive(self) -> bool:
        """Whether it still serves."""
        return bool(self._tasks) and not self._tasks[0].done()

    async def ask(self, what: str, **details: object) -> dict[str, Any]:
        """Return the answer to a request.  Raises CameraError, CameraLost if the process ends instead."""
        if self._writer is None or not self.alive:
            raise CameraLost(self._obituary())
        self._number = number = self._number + 1
        future: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[number] = future
        document = {"do": what, "number": number} | details
        self._writer.write(json.dumps(document).encode() + b"\n")
        try:
            return await future
        finally:
            self._waiting.pop(number, None)

    def pixels(self, count: int, info: CameraInfo) -> Pixels:
        """Return the picture in the shared memory, in memory of its own."""
        data = np.frombuffer(self._memory, np.uint8, count=count)
        return decode_pixels(data, info.width, info.height, PIXEL_FORMATS[info.pixel_format])

    async def end(self) -> None:
        """Kill the process, whatever it is doing."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        if self._writer is not None:
            self._writer.close()
            with contextlib.suppress(OSError):
                await self._writer.wait_closed()
        if self._tasks:
            await asyncio.wait(self._tasks)
        os.close(self._memory_fd)
        # The mapping goes with the last array that looks into it.

    async def _read(self, reader: asyncio.StreamReader) -> None:
        try:
            while line := await reader.readline():
                answer = json.loads(line)
                self.counts = answer.get("counts", self.counts)
                future = self._waiting.get(answer["number"])
                if future is None or future.done():
                    continue  # whoever asked has gone
                if "error" in answer:
                    future.set_exception(_error(answer["error"], answer["message"]))
                else:
                    future.set_result(answer["result"])
        except OSError:
            pass  # the process died between two bytes: the same as if it had ended
        finally:
            for future in self._waiting.values():
                if not future.done():
                    future.set_exception(CameraLost(self._obituary()))

    async def _listen(self, output: asyncio.StreamReader | None) -> None:
        """Keep the end of what a producer prints; it may print for months."""
        while output is not None and (words := await output.read(4096)):
            self._last_words = (self._last_words + words)[-_LAST_WORDS_BYTES:]

    def _obituary(self) -> str:
        """Say that the process has ended, with its last words."""
        words = self._last_words.decode("utf-8", "replace").strip().rpartition("\n")[2]
        return f"camera {self._name}: the GenTL producer's process has ended" + (f" ({words})" if words else "")


def _error(name: str, message: str) -> CameraError:
    """Return the camera error of this name; what is none is a lost camera."""
    found = getattr(protocol, name, None)
    if isinstance(found, type) and issubclass(found, CameraError):
        return found(message)
    return CameraLost(f"{name}: {message}")
