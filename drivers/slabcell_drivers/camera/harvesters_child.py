"""What runs in the process beside the daemon that holds Harvesters?  A loop that answers one request at a time.

Requests and answers are lines of JSON on a socket, pixels go through shared memory.  The process ends when the socket
does, and the kernel ends it when its parent dies, even if a producer hangs.
"""

import ctypes
import json
import mmap
import signal
import socket
import sys
import time
from typing import Any, Final

import numpy as np

from slabcell_drivers.camera.protocol import CameraError, CameraLost
from slabcell_drivers.camera.settings import CameraSettings

__all__ = ["SHARED_BYTES"]

SHARED_BYTES: Final = 256 << 20
"""Room for the largest frame; memory is taken only for what is written."""
_PR_SET_PDEATHSIG: Final = 1


def _serve(channel: socket.socket, memory_fd: int) -> None:
    # Imported here: an installation without Harvesters says so as the answer to a request.
    from slabcell_drivers.camera.harvesters_device import HarvestersDevice  # noqa: PLC0415

    memory = np.frombuffer(mmap.mmap(memory_fd, SHARED_BYTES), np.uint8)
    device: HarvestersDevice | None = None

    def answer(request: dict[str, Any]) -> dict[str, Any]:
        nonlocal device
        match request["do"]:
            case "start":
                settings = CameraSettings(**request["settings"])
                device = HarvestersDevice(request["producers"], request["camera"], request["serial"], settings)
                info, address = device.start()
                names = ("vendor", "model", "serial", "width", "height", "pixel_format")
                return {name: getattr(info, name) for name in names} | {"address": address}
            case "snap" if device is not None:
                triggered_s = time.monotonic()
                pixels, document = device.snap(request["deadline_s"])
                memory[: pixels.size] = pixels
                return document | {"triggered_s": triggered_s, "counts": device.counts}
            case "close" if device is not None:
                device.close()
                device = None
                return {}
            case other:
                raise CameraLost(f"the camera is not open, so it cannot {other}")

    with channel, channel.makefile("rb") as requests:
        for line in requests:
            request = json.loads(line)
            try:
                document = {"number": request["number"], "result": answer(request)}
            except CameraError as error:
                document = {"number": request["number"], "error": type(error).__name__, "message": str(error)}
            channel.sendall(json.dumps(document).encode() + b"\n")


def main() -> None:
    """Serve the parent on the descriptors that it passed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's; it ends this process itself
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    channel = socket.socket(fileno=int(sys.argv[1]))
    try:
        _serve(channel, int(sys.argv[2]))
    except ImportError as error:
        message = f"Harvesters is not installed ({error}): pip install 'slabcell[camera]'"
        channel.sendall(json.dumps({"number": 1, "error": "CameraConfigError", "message": message}).encode() + b"\n")


if __name__ == "__main__":
    main()
