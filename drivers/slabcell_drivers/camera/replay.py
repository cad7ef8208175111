"""How are stored pictures taken again?  Image files and cycle bundles behind the `Camera` protocol, one a trigger.

A bundle is a zip file that holds the picture as ``frame.png``.  Files come from anywhere: what is too large, damaged or
no picture is refused by name.  The replay is *not* responsible for what belongs to the pictures (calibration, truth,
results); it serves pixels.
"""

import asyncio
import time
import zipfile
import zlib
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

import cv2
import numpy as np

from slabcell_drivers.camera.protocol import (
    CameraConfigError,
    CameraIncomplete,
    CameraInfo,
    CameraLost,
    CameraState,
    CameraTimeout,
    ImageFrame,
    Pixels,
)

__all__ = ["ReplayCamera", "ReplayMode"]

SUFFIXES = frozenset({".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".ppm", ".webp"})
BUNDLE_SUFFIX = ".zip"
BUNDLE_MEMBER = "frame.png"
MAX_FILE_BYTES = 512 << 20
MAX_FILES = 100_000


class ReplayMode(StrEnum):
    """What comes after the last picture."""

    ONCE = "once"  # the camera is lost
    LOOP = "loop"  # the first picture again


class ReplayCamera:
    """A `Camera` that serves the pictures of a directory in the order of their names, one file, or given files."""

    def __init__(
        self, source: Path | Sequence[Path], *, mode: ReplayMode = ReplayMode.ONCE, serial: str = "REPLAY"
    ) -> None:
        self._source = source
        self._mode = mode
        self._serial = serial
        self._state = CameraState.CLOSED
        self._files: tuple[Path, ...] = ()
        self._next = 0
        self._frame_id = 0
        self._info: CameraInfo | None = None
        self._busy = asyncio.Lock()

    @property
    def state(self) -> CameraState:
        """Where the camera stands now."""
        return self._state

    @property
    def upcoming(self) -> Path | None:
        """The file that the next trigger shows, None before `open` and after the last."""
        return self._files[self._next] if self._next < len(self._files) else None

    def choose(self, name: str) -> None:
        """Let the next trigger show the file of this name; the ones after it follow.  Raises KeyError by name."""
        for index, file in enumerate(self._files):
            if file.name == name:
                self._next = index
                return
        msg = f"camera {self._serial}: no picture {name!r} among the {len(self._files)} of this replay"
        raise KeyError(msg)

    async def open(self, timeout_s: float) -> CameraInfo:
        """List the files and look at the first; the replay begins at the first file.  Raises `CameraError`."""
        self._state = CameraState.OPENING
        try:
            async with asyncio.timeout(timeout_s), self._busy:
                self._files = await asyncio.to_thread(_list, self._source)
                first = await asyncio.to_thread(_read, self._files[0])
        except TimeoutError as error:
            self._state = CameraState.LOST
            msg = f"camera {self._serial}: its pictures could not be read within {timeout_s:g} s"
            raise CameraTimeout(msg) from error
        except BaseException:
            self._state = CameraState.LOST
            raise
        self._next = self._frame_id = 0
        height, width = first.shape[:2]
        self._info = CameraInfo("slabcell", "replay", self._serial, width, height, _format(first))
        self._state = CameraState.READY
        return self._info

    async def snap(self, timeout_s: float) -> ImageFrame:
        """Return the next picture.  Raises `CameraError`; a file that cannot be read is passed over next time."""
        try:
            async with asyncio.timeout(timeout_s), self._busy:
                return await self._snap()
        except TimeoutError as error:
            msg = f"camera {self._serial}: the picture could not be read within {timeout_s:g} s"
            raise CameraTimeout(msg) from error

    async def close(self) -> None:
        """Give the camera back; may be called twice."""
        self._state = CameraState.CLOSED

    async def _snap(self) -> ImageFrame:
        if self._state is not CameraState.READY or self._info is None:
            msg = f"camera {self._serial}: is {self._state.value}: open it before a picture is taken"
            raise CameraLost(msg)
        if self._next >= len(self._files) and self._mode is ReplayMode.LOOP:
            self._next = 0
        if self._next >= len(self._files):
            self._state = CameraState.LOST
            msg = f"camera {self._serial}: all {len(self._files)} pictures have been shown: open it again, or loop"
            raise CameraLost(msg)
        triggered_s = time.monotonic()
        file = self._files[self._next]
        self._next += 1
        self._frame_id += 1
        pixels = await asyncio.to_thread(_read, file)
        if pixels.shape[:2] != (self._info.height, self._info.width):
            msg = (
                f"camera {self._serial}: {file.name} has {pixels.shape[1]}x{pixels.shape[0]} pixels, the first picture "
                f"{self._info.width}x{self._info.height}: keep pictures of one camera in one directory"
            )
            raise CameraIncomplete(msg)
        return ImageFrame(pixels, _format(pixels), self._frame_id, triggered_s, time.monotonic())


def _list(source: Path | Sequence[Path]) -> tuple[Path, ...]:
    if isinstance(source, Path):
        usual = SUFFIXES | {BUNDLE_SUFFIX}
        try:
            whole = [source] if source.is_file() else sorted(source.iterdir())
            found = [path for path in whole if path.suffix.lower() in usual]
        except OSError as error:
            msg = f"{source}: cannot be read: {error.strerror}"
            raise CameraLost(msg) from error
    else:
        found = list(source)
    if not found:
        msg = f"{source}: holds no picture ({', '.join(sorted(SUFFIXES))})"
        raise CameraLost(msg)
    if len(found) > MAX_FILES:
        msg = f"{source}: holds {len(found)} pictures; at most {MAX_FILES} are replayed"
        raise CameraConfigError(msg)
    return tuple(found)


def _read(file: Path) -> Pixels:
    """Return the pixels of a file: (h, w) uint8 or uint16, or (h, w, 3) in BGR order."""
    try:
        size = file.stat().st_size
        if size > MAX_FILE_BYTES:
            msg = f"{file}: has {size} bytes; at most {MAX_FILE_BYTES} are read"
            raise CameraIncomplete(msg)
        content = _from_bundle(file) if file.suffix.lower() == BUNDLE_SUFFIX else file.read_bytes()
        raw = np.frombuffer(content, np.uint8)
        image = cv2.imdecode(raw, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR) if len(raw) else None
    except OSError as error:
        msg = f"{file}: cannot be read: {error.strerror}"
        raise CameraIncomplete(msg) from error
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError) as error:
        msg = f"{file}: is not a bundle that can be read: {error}"
        raise CameraIncomplete(msg) from error
    except cv2.error as error:
        msg = f"{file}: is not a picture that can be decoded: {error.err}"
        raise CameraIncomplete(msg) from error
    if image is None or image.size == 0:
        msg = f"{file}: is not a picture that can be decoded"
        raise CameraIncomplete(msg)
    if image.dtype == np.uint16:
        return np.asarray(image, np.uint16)
    if image.dtype != np.uint8:
        msg = f"{file}: has pixels of type {image.dtype}; 8 and 16 bits are read"
        raise CameraIncomplete(msg)
    return np.asarray(image, np.uint8)


def _from_bundle(file: Path) -> bytes:
    """Return the picture file that a bundle holds, never more than the limit, whatever its directory claims."""
    with zipfile.ZipFile(file) as archive:
        if BUNDLE_MEMBER not in archive.namelist():
            msg = f"{file}: holds no {BUNDLE_MEMBER}: that cycle has no picture"
            raise CameraIncomplete(msg)
        with archive.open(BUNDLE_MEMBER) as member:
            content = member.read(MAX_FILE_BYTES + 1)
    if len(content) > MAX_FILE_BYTES:
        msg = f"{file}: its {BUNDLE_MEMBER} has more than {MAX_FILE_BYTES} bytes"
        raise CameraIncomplete(msg)
    return content


def _format(pixels: Pixels) -> str:
    if pixels.ndim == 3:
        return "BGR16" if pixels.dtype == np.uint16 else "BGR8"
    return "Mono16" if pixels.dtype == np.uint16 else "Mono8"
