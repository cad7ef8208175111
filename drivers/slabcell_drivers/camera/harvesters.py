"""How is any camera with a GenTL producer used?  Through Harvesters, in a child process that may hang or crash.

The genicam binding holds Python's global lock while a producer waits for a dead camera, so it must not live in the
daemon.  Each connection has a process of its own: what a producer leaks, ends with it.  This module is *not*
responsible for reconnecting (`supervision`) or for the calls themselves (`harvesters_device`).
"""

import asyncio
import contextlib
import json
import mmap
import os
import socket
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from ipaddress import IPv4Address
from pathlib import Path
from typing import Any, Final

import numpy as np

from slabcell_drivers.camera import protocol
from slabcell_drivers.camera.discovery import Interface, find_camera
from slabcell_drivers.camera.harvesters_child import SHARED_BYTES
from slabcell_drivers.camera.pixel_formats import PIXEL_FORMATS, decode_pixels
from slabcell_drivers.camera.probe import Sight, look
from slabcell_drivers.camera.protocol import CameraConfigError, CameraError, CameraInfo, CameraLost, ImageFrame, Pixels
from slabcell_drivers.camera.settings import CameraSettings, CameraStatistics
from slabcell_drivers.camera.supervision import SupervisedCamera
from slabcell_drivers.gentl import ProducerBuildError, build

__all__ = ["HarvestersCamera", "producers_of_environment"]

PRODUCERS_VARIABLE: Final = "GENICAM_GENTL64_PATH"
CLOSE_S: Final = 3.0
_CHILD: Final = "slabcell_drivers.camera.harvesters_child"


def producers_of_environment() -> tuple[Path, ...]:
    """Return the producers (.cti) in the folders that GENICAM_GENTL64_PATH names, as vendors' installers set it."""
    folders = [Path(text) for text in os.environ.get(PRODUCERS_VARIABLE, "").split(os.pathsep) if text]
    return tuple(path for folder in folders for path in sorted(folder.glob("*.cti")))


class HarvestersCamera(SupervisedCamera):
    """The camera with this serial number, device id, user-defined name or, for GigE Vision, IPv4 address.

    ``producers`` are the .cti files to look in; the default are those that GENICAM_GENTL64_PATH leads to, and without
    any our own over Aravis, which is built when it is first needed.
    """

    def __init__(
        self,
        camera: str,
        producers: Sequence[Path] | None = None,
        settings: CameraSettings | None = None,
        *,
        on: Sequence[Interface] | None = None,
    ) -> None:
        statistics = CameraStatistics()
        chosen = tuple(producers) if producers is not None else producers_of_environment()
        self._harvesters = _HarvestersBackend(camera, chosen, settings or CameraSettings(), statistics, on)
        super().__init__(self._harvesters, statistics)

    @property
    def process_id(self) -> int | None:
        """The process that holds the producer, None if there is none now."""
        return self._harvesters.process_id


class _HarvestersBackend:
    def __init__(
        self,
        camera: str,
        producers: tuple[Path, ...],
        settings: CameraSettings,
        statistics: CameraStatistics,
        on: Sequence[Interface] | None,
    ) -> None:
        self.name = camera
        self._producers = producers
        self._settings = settings
        self._statistics = statistics
        self._on = on
        self._child: _Child | None = None
        self._info: CameraInfo | None = None
        self._address = ""
        self._counted: dict[str, int] = {}
        self._connected = False

    @property
    def process_id(self) -> int | None:
        return self._child.process_id if self._child else None

    async def look(self, timeout_s: float) -> Sight:
        if self._child is not None and not self._child.alive:
            self._connected = False
            return Sight.SILENT
        if self._address:
            return await look(self._address, timeout_s)
        return Sight.CONTROLLED if self._connected else Sight.FREE

    async def connect(self) -> CameraInfo:
        if not self._producers:
            try:
                self._producers = (await asyncio.to_thread(build),)
            except ProducerBuildError as error:
                raise CameraConfigError(
                    f"camera {self.name}: no GenTL producer (.cti) is given, {PRODUCERS_VARIABLE} leads to none, and"
                    f" {error}"
                ) from error
        missing = [str(path) for path in self._producers if not path.is_file()]
        if missing:
            raise CameraConfigError(f"camera {self.name}: there is no GenTL producer {', '.join(missing)}")
        await self.disconnect(lost=True)
        child = self._child = await _Child.start(self.name)
        try:
            found = await child.ask(
                "start",
                producers=[str(path) for path in self._producers],
                camera=self.name,
                serial=await self._serial(),
                settings=asdict(self._settings),
            )
        except BaseException:
            await self.disconnect(lost=True)
            raise
        self._address = found.pop("address")
        self._info = CameraInfo(**found)
        self._counted = {}
        self._connected = True
        return self._info

    async def shoot(self, deadline_s: float) -> ImageFrame:
        child, info = self._child, self._info
        if child is None or info is None:
            raise CameraLost(f"camera {self.name}: is not connected")
        found = await child.ask("snap", deadline_s=deadline_s)
        pixels = await asyncio.to_thread(child.pixels, found["bytes"], info)
        received_s = time.monotonic()
        self._count(found["counts"])
        self._statistics.latency_s = received_s - found["triggered_s"]
        return ImageFrame(
            pixels,
            info.pixel_format,
            found["frame_id"],
            found["triggered_s"],
            received_s,
            found["device_timestamp_ns"],
        )

    async def disconnect(self, *, lost: bool) -> None:
        child, self._child = self._child, None
        self._connected = False
        if child is None:
            return
        if not lost and child.alive:
            with contextlib.suppress(CameraError, TimeoutError):  # it is ended in any case
                await asyncio.wait_for(child.ask("close"), CLOSE_S)
        await child.end()

    async def end(self, timeout_s: float) -> None:
        del timeout_s
        self._address = ""
        await self.disconnect(lost=True)

    async def _serial(self) -> str:
        """Return the serial number of the camera at an address, or the name as it was given."""
        try:
            IPv4Address(self.name)
        except ValueError:
            return self.name
        found = await asyncio.to_thread(find_camera, self.name, 0.3, on=self._on)
        if found is None:
            raise CameraLost(f"camera {self.name}: does not answer: check its power, its cable and its address")
        return found.serial

    def _count(self, counts: dict[str, int]) -> None:
        for name, value in counts.items():
            grown = value - self._counted.get(name, 0)
            setattr(self._statistics, name, getattr(self._statistics, name) + grown)
        self._counted = counts
        self._statistics.frames += 1


class _Child:
    """The process, its socket, and the memory that it shares with us."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._memory_fd = os.memfd_create("slabcell-frame", os.MFD_CLOEXEC)
        os.ftruncate(self._memory_fd, SHARED_BYTES)
        self._memory = mmap.mmap(self._memory_fd, SHARED_BYTES, prot=mmap.PROT_READ)
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._number = 0
        self._process: asyncio.subprocess.Process | None = None
        self._reader: asyncio.Task[None] | None = None
        self._writer: asyncio.StreamWriter | None = None

    @classmethod
    async def start(cls, name: str) -> "_Child":
        """Start a process."""
        child = cls(name)
        ours, theirs = socket.socketpair()
        try:
            child._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", _CHILD, str(theirs.fileno()), str(child._memory_fd),
                stdin=asyncio.subprocess.DEVNULL, stdout=child._errors, stderr=child._errors,
                pass_fds=(theirs.fileno(), child._memory_fd),
            )  # fmt: skip
        except BaseException:
            ours.close()
            await child.end()
            raise
        finally:
            theirs.close()
        reader, child._writer = await asyncio.open_connection(sock=ours)
        child._reader = asyncio.create_task(child._read(reader), name=f"harvesters {name}")
        return child

    @property
    def process_id(self) -> int | None:
        return self._process.pid if self._process else None

    @property
    def alive(self) -> bool:
        """Whether it still serves."""
        return self._reader is not None and not self._reader.done()

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
        if self._reader is not None:
            await asyncio.wait({self._reader})
        os.close(self._memory_fd)
        self._errors.close()
        # The mapping goes with the last array that looks into it.

    async def _read(self, reader: asyncio.StreamReader) -> None:
        try:
            while line := await reader.readline():
                answer = json.loads(line)
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

    def _obituary(self) -> str:
        """Say that the process has ended, with its last words."""
        words = ""
        if not self._errors.closed:
            self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - 400))
            words = self._errors.read().decode("utf-8", "replace").strip().rpartition("\n")[2]
        return f"camera {self._name}: the GenTL producer's process has ended" + (f" ({words})" if words else "")


def _error(name: str, message: str) -> CameraError:
    """Return the camera error of this name; what is none is a lost camera."""
    found = getattr(protocol, name, None)
    if isinstance(found, type) and issubclass(found, CameraError):
        return found(message)
    return CameraLost(f"{name}: {message}")
