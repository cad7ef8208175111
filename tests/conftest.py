"""Does every test leave the process as it found it?  Fails a test that leaks a task, a thread or a socket."""

import asyncio
import gc
import inspect
import os
import threading
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress

import pytest

GRACE_S = 2.0
"""A thread that was told to end may need a moment to be gone."""


def pytest_itemcollected(item: pytest.Item) -> None:
    """Have tests that are coroutines watched for tasks."""
    if isinstance(item, pytest.Function) and inspect.iscoroutinefunction(item.obj):
        item.fixturenames.insert(0, "no_leaked_tasks")


@pytest.fixture
async def no_leaked_tasks() -> AsyncIterator[None]:
    before = asyncio.all_tasks()
    yield
    await asyncio.sleep(0)  # a task that was awaited may still have its last step to do
    leaked = asyncio.all_tasks() - before - {asyncio.current_task()}
    assert not leaked, f"tasks left behind: {[task.get_name() for task in leaked]}"


@pytest.fixture(autouse=True)
def no_leaked_threads_or_sockets() -> Iterator[None]:
    threads, sockets = _threads(), _sockets()
    yield
    deadline = time.monotonic() + GRACE_S
    for thread in _threads() - threads:
        thread.join(max(0.0, deadline - time.monotonic()))
    left = [thread.name for thread in _threads() - threads]
    assert not left, f"threads left behind: {left}"
    if _sockets() - sockets:
        gc.collect()  # raises the warning of an unclosed socket, which names where it was opened
        leaked = _sockets() - sockets
        assert not leaked, f"sockets left behind: {leaked}"


def _threads() -> set[threading.Thread]:
    """Return the threads that somebody has to end: those of a loop's own executor end with the loop, a little later."""
    return {thread for thread in threading.enumerate() if not thread.name.startswith("asyncio_")}


def _sockets() -> set[str]:
    """Return the sockets of this process as the kernel names them; empty where there is no /proc."""
    found: set[str] = set()
    with suppress(FileNotFoundError):
        for name in os.listdir("/proc/self/fd"):  # noqa: PTH208 - called twice for each test: the plainest way
            with suppress(OSError):
                target = os.readlink(f"/proc/self/fd/{name}")  # noqa: PTH115 - as above
                if target.startswith("socket:"):
                    found.add(target)
    return found
