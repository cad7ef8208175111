"""Which device does the configuration mean?  Builds the real camera, and the lock that keeps a second cell away."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Self

from slabcell.errors import ConfigurationError, TemporaryError, UnavailableError
from slabcell.service.config import CameraConfig
from slabcell_drivers.camera import Camera, ReplayCamera
from slabcell_drivers.camera.aravis import AravisCamera
from slabcell_drivers.camera.aravis_library import AravisMissingError
from slabcell_drivers.camera.harvesters import HarvestersCamera
from slabcell_drivers.camera.replay import ReplayMode

__all__ = ["InstanceLock", "api_socket", "make_camera", "state_directory"]


def make_camera(config: CameraConfig) -> Camera:
    """Return the camera, not yet open.  Raises UnavailableError if its library is not installed."""
    match config.driver:
        case "aravis":
            try:
                return AravisCamera(config.camera, config.settings())
            except AravisMissingError as error:
                msg = f"[camera] driver aravis: {error}"
                raise UnavailableError(msg) from error
        case "harvesters":
            return HarvestersCamera(config.camera, config.producers or None, config.settings())
        case "replay":
            return ReplayCamera(config.images or Path(), mode=ReplayMode.LOOP)
        case "simulated":
            msg = "[camera] driver simulated: only `slabcell demo` has a simulated world to look at; choose another"
            raise ConfigurationError(msg)


def state_directory(configured: Path | None) -> Path:
    """Return the folder of ledger and bundles, made if need be.  Raises ConfigurationError."""
    found = configured or (Path(os.environ["STATE_DIRECTORY"]) if os.environ.get("STATE_DIRECTORY") else None)
    if found is None:
        msg = "no state_directory: name one in the configuration, or start the cell through systemd, which names one"
        raise ConfigurationError(msg)
    try:
        found.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"state_directory {found}: cannot be made: {error.strerror}; choose another, or give the user the right"
        raise ConfigurationError(msg) from error
    return found


def api_socket(configured: Path | None, folder: Path) -> Path:
    """Return where the control API is served: as configured, in systemd's runtime directory, or beside the state."""
    if configured is not None:
        return configured
    runtime = os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    return (Path(runtime) if runtime else folder) / "api.sock"


class InstanceLock:
    """Keeps a second cell off the same state.  The lock ends with the process, whatever ends it."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "lock"
        self._file: int | None = None

    def __enter__(self) -> Self:
        """Take the lock.  Raises TemporaryError if another process holds it, UnavailableError if it cannot write."""
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        except OSError as error:
            msg = f"{self._path}: cannot be written: {error.strerror}; the daemon has to write into state_directory"
            raise UnavailableError(msg) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(self._file, 32).decode("ascii", "replace").strip() or "unknown"
            os.close(self._file)
            self._file = None
            msg = f"{self._path}: another slabcell (process {holder}) runs this cell; stop it first"
            raise TemporaryError(msg) from error
        os.ftruncate(self._file, 0)
        os.write(self._file, f"{os.getpid()}\n".encode("ascii"))
        return self

    def __exit__(self, *_: object) -> None:
        """Give the lock back."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
