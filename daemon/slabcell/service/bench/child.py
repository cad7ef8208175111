"""The bench itself: a process of low priority that does one task after the other, until its socket closes.

Started by `process` as ``python -m slabcell.service.bench.child DESCRIPTOR``.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import socket
import sys

import cv2

from slabcell.errors import SlabcellError
from slabcell.service.bench.tasks import TASKS, Work
from slabcell.service.bench.wire import Json, WireError, receive, send

__all__ = ["main"]

NICE = 15


def main(descriptor: int) -> None:
    """Serve the socket that was inherited."""
    faulthandler.enable()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is for the daemon, which ends this too
    os.setpriority(os.PRIO_PROCESS, 0, NICE)
    cv2.setNumThreads(1)
    with socket.socket(fileno=descriptor) as daemon:
        while True:
            try:
                asked = receive(daemon)
            except WireError:
                return

            def progress(content: Json) -> None:
                send(daemon, {"progress": content})

            try:
                done = TASKS[asked.content["task"]](Work(asked.content["arguments"], asked.blobs, progress))
            except SlabcellError as error:
                problems = getattr(error, "problems", ())
                words = {"kind": type(error).__name__, "message": str(error), "number": error.number}
                send(daemon, {"error": {**words, "problems": list(problems)}})
            except Exception as error:  # noqa: BLE001 - a task that breaks must not end the bench
                send(daemon, {"error": {"kind": "", "message": f"{type(error).__name__}: {error}", "number": 0}})
            else:
                send(daemon, {"result": done.content}, done.blobs)


if __name__ == "__main__":
    main(int(sys.argv[1]))
