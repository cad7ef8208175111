"""What runs in the process beside the daemon that holds Harvesters?  A loop that answers one request at a time.

Requests and answers are lines of JSON on a socket, pixels go through shared memory.  The process ends when the socket
does, and the kernel ends it when its parent dies, even if a producer hangs.
"""

import contextlib
import ctypes
import importlib
import json
import mmap
import os
import signal
import socket
import sys
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from slabcell_drivers.camera.protocol import CameraConfigError, CameraError, CameraLost
from slabcell_drivers.camera.settings import CameraSettings

if TYPE_CHECKING:
    from slabcell_drivers.camera.harvesters_device import HarvestersDevice

__all__ = ["PRODUCER_ADDRESSES", "SHARED_BYTES"]

SHARED_BYTES: Final = 256 << 20
"""Room for the largest frame; memory is taken only for what is written."""
PRODUCER_ADDRESSES: Final = "SLABCELL_GENTL_ADDRESSES"
"""Environment variable by which our own producer is told to ask these addresses, instead of everybody for a second."""
_PR_SET_PDEATHSIG: Final = 1


class _Server:
    """Answers requests for one camera."""

    def __init__(self, memory: npt.NDArray[np.uint8]) -> None:
        self._memory = memory
        self._device: HarvestersDevice | None = None

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        """Do what is asked.  Raises CameraError."""
        document: dict[str, Any] = {"number": request["number"]}
        try:
            document["result"] = self._result(request)
        except CameraError as error:
            document |= {"error": type(error).__name__, "message": str(error)}
        if self._device is not None:
            document["counts"] = asdict(self._device.statistics)
        return document

    def _result(self, request: dict[str, Any]) -> dict[str, Any]:
        match request["do"]:
            case "start":
                return self._start(request)
            case "snap" if self._device is not None:
                return asdict(self._device.snap(request["deadline_s"]))
            case "close" if self._device is not None:
                self._device.close()
                self._device = None
                return {}
            case other:
                raise CameraLost(f"the camera is not open, so it cannot {other}")

    def _start(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            from slabcell_drivers.camera.harvesters_device import HarvestersDevice  # noqa: PLC0415 - optional packages
        except ImportError as error:
            raise CameraConfigError(
                f"camera {request['camera']}: Harvesters is not installed ({error}): pip install 'slabcell[camera]'"
            ) from error
        if request["address"]:
            os.environ[PRODUCER_ADDRESSES] = request["address"]
        settings = CameraSettings(**request["settings"])
        self._device = HarvestersDevice(
            request["producers"], request["camera"], request["serial"], settings, self._memory
        )
        info, address = self._device.start()
        return asdict(info) | {"address": address}


def main() -> None:
    """Serve the parent on the descriptors that it passed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's; it ends this process itself
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # Loaded before it is asked for, while the camera is still away; `start` says so if it is not installed.
    with contextlib.suppress(ImportError):
        importlib.import_module("slabcell_drivers.camera.harvesters_device")
    server = _Server(np.frombuffer(mmap.mmap(int(sys.argv[2]), SHARED_BYTES), np.uint8))
    with socket.socket(fileno=int(sys.argv[1])) as channel, channel.makefile("rb") as requests:
        for line in requests:
            channel.sendall(json.dumps(server.answer(json.loads(line))).encode() + b"\n")


if __name__ == "__main__":
    main()
