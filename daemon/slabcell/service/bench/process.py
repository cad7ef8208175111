"""The bench's process, as one thread of the daemon uses it: started when first needed, asked, stopped, killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import slabcell.errors
from slabcell.errors import SlabcellError, TemplateError
from slabcell.service.bench.wire import Json, Message, WireError, receive, send

__all__ = ["BenchError", "BenchProcess"]

END_TIMEOUT_S = 2.0


class BenchError(SlabcellError):
    """A task did not come to its end: it took too long, was cancelled, or broke the bench."""


class BenchProcess:
    """The child.  `ask` blocks and belongs to one thread; `pause`, `resume` and `kill` may come from any."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._lock = threading.Lock()
        self._paused = False
        """What is wanted; `_settle` makes it so."""
        self._stopped = False
        """Whether the present process was stopped."""

    @property
    def pid(self) -> int | None:
        """The process, while there is one."""
        return self._process.pid if self._process else None

    def ask(
        self,
        task: str,
        arguments: Json,
        blobs: Sequence[bytes | memoryview],
        *,
        timeout_s: float,
        progress: Callable[[Json], None],
    ) -> Message:
        """Return what came of a task.  Raises SlabcellError as the task did, or BenchError."""
        daemon_end = self._started()
        deadline_s = time.monotonic() + timeout_s
        try:
            daemon_end.settimeout(timeout_s)
            send(daemon_end, {"task": task, "arguments": arguments}, blobs)
            while True:
                daemon_end.settimeout(max(0.01, deadline_s - time.monotonic()))
                said = receive(daemon_end)
                if "progress" in said.content:
                    progress(said.content["progress"])
                elif "error" in said.content:
                    raise _error(said.content["error"])
                else:
                    return Message(said.content["result"], said.blobs)
        except TimeoutError as error:
            self.kill()
            msg = (
                f"{task} was not ready after {timeout_s:g} s and was ended: this computer is busy, and the cell comes"
                " first. Try again when the cell waits, or on fewer pixels: a region of interest, a smaller picture"
            )
            raise BenchError(msg) from error
        except (OSError, WireError, ValueError) as error:
            status = self._status()
            self.kill()
            msg = f"{task} was ended before it was ready ({status or error})"
            raise BenchError(msg) from error

    def pause(self) -> None:
        """Let the process stand still: the cell needs the processor.  Never blocks."""
        self._paused = True
        self._settle()

    def resume(self) -> None:
        """Let it go on.  Never blocks."""
        self._paused = False
        self._settle()

    def kill(self) -> None:
        """End the process, whatever it does; the next task starts another."""
        with self._lock:
            process, daemon_end = self._process, self._socket
            self._process = self._socket = None
            if process is not None:
                process.kill()
                with suppress(subprocess.TimeoutExpired):
                    process.wait(END_TIMEOUT_S)
            if daemon_end is not None:
                with suppress(OSError):
                    daemon_end.shutdown(socket.SHUT_RDWR)  # wakes the thread that reads from it
                daemon_end.close()
            self._stopped = False

    def _started(self) -> socket.socket:
        try:
            with self._lock:
                return self._running()
        finally:
            self._settle()

    def _running(self) -> socket.socket:
        if self._process is not None and self._socket is not None and self._process.poll() is None:
            return self._socket
        if self._socket is not None:
            self._socket.close()
        self._stopped = False
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(  # noqa: S603 - our own module, by the interpreter that runs this
                [sys.executable, "-m", "slabcell.service.bench.child", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            )
        return self._socket

    def _settle(self) -> None:
        """Stop the process or let it go on, as is wanted now; whoever holds the lock does this when it is free."""
        while self._stopped is not self._paused and self._lock.acquire(blocking=False):
            try:
                if self._process is None or self._process.poll() is not None:
                    return
                self._process.send_signal(signal.SIGSTOP if self._paused else signal.SIGCONT)
                self._stopped = not self._stopped
            finally:
                self._lock.release()

    def _status(self) -> str:
        process = self._process
        if process is None:
            return "cancelled"
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_TIMEOUT_S)
        return "" if process.returncode is None else f"the bench ended with status {process.returncode}"


def _error(said: Any) -> SlabcellError:
    kind = getattr(slabcell.errors, str(said["kind"]), None)
    message, number = str(said["message"]), int(said["number"])
    if kind is TemplateError:
        return TemplateError(message, problems=tuple(map(str, said["problems"])), number=number)
    if isinstance(kind, type) and issubclass(kind, SlabcellError):
        return kind(message, number=number)
    return BenchError(message, number=number)
