"""The control loop stands still: is the watchdog left unfed, and is the end of the process told with its reason?"""

import asyncio
import re
import signal
import socket
import threading

import pytest

from slabcell.service.watchdog import feed
from slabcell_drivers.robot.protocol import RequestType

pytestmark = [pytest.mark.faults, pytest.mark.timeout(120)]

INTERVAL_S = 0.02


@pytest.fixture
def supervisor(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listener


def heard(supervisor) -> int:
    """Take what has come so far; return how many signs of life were among it."""
    signs = 0
    while True:
        try:
            signs += supervisor.recv(4096) == b"WATCHDOG=1"
        except BlockingIOError:
            return signs


async def until_fed(supervisor) -> None:
    async with asyncio.timeout(30):
        while not heard(supervisor):  # noqa: ASYNC110 - what comes is a datagram of another socket
            await asyncio.sleep(INTERVAL_S)


async def end(feeding) -> None:
    feeding.cancel()
    await asyncio.gather(feeding, return_exceptions=True)


async def test_a_ledger_that_does_not_answer_leaves_the_watchdog_unfed(make_bench, supervisor):
    bench = make_bench()
    await bench.start()
    feeding = asyncio.create_task(feed(bench.cell, bench.ledger, INTERVAL_S, alive_timeout_s=0.1))
    await until_fed(supervisor)
    stuck, go_on = threading.Event(), threading.Event()
    blocked = asyncio.create_task(bench.ledger.run(lambda _: (stuck.set(), go_on.wait(60))))
    await asyncio.to_thread(stuck.wait, 60)
    heard(supervisor)
    await asyncio.sleep(10 * INTERVAL_S)  # ten signs are due, and none comes
    assert heard(supervisor) == 0
    go_on.set()
    await blocked
    await until_fed(supervisor)
    await end(feeding)
    await bench.stop()


async def test_an_event_loop_that_stands_still_leaves_the_watchdog_unfed(make_bench, supervisor):
    bench = make_bench()
    await bench.start()
    feeding = asyncio.create_task(feed(bench.cell, bench.ledger, INTERVAL_S))
    await until_fed(supervisor)
    heard(supervisor)
    threading.Event().wait(10 * INTERVAL_S)  # the loop's own thread stands still
    assert heard(supervisor) == 0
    await until_fed(supervisor)
    await end(feeding)
    await bench.stop()


async def test_a_request_that_never_ends_leaves_the_watchdog_unfed_although_the_loop_turns(make_bench, supervisor):
    bench = make_bench()
    hanging = asyncio.Event()

    async def never(_timeout_s):
        await hanging.wait()
        raise RuntimeError

    await bench.start()
    await bench.robot.hello()
    bench.camera.snap = never
    feeding = asyncio.create_task(feed(bench.cell, bench.ledger, INTERVAL_S))
    asking = asyncio.create_task(bench.robot.ask(RequestType.TRIGGER))
    await until_fed(supervisor)
    bench.now_s += 3600.0  # an hour later, on the clock that the deadlines are of
    heard(supervisor)
    await asyncio.sleep(10 * INTERVAL_S)
    assert heard(supervisor) == 0
    hanging.set()
    await asking
    await end(feeding)
    await bench.stop()


def test_a_process_that_the_watchdog_ends_says_where_its_threads_stood(cell):
    with cell.daemon() as daemon:
        daemon.process.send_signal(signal.SIGABRT)  # what systemd sends
        # CPython reads the stacks of threads that run on meanwhile, and has once stumbled over one: the first that is
        # said has to be the signal all the same, a crash of our own is none.
        assert daemon.process.wait(60) in (-signal.SIGABRT, -signal.SIGSEGV)
    said = (cell.folder / "daemon.log").read_text()
    assert re.findall("Fatal Python error: (.*)", said)[0] == "Aborted"
    assert "slabcell/service/daemon.py" in said or "asyncio" in said
    # What comes after is a daemon that starts as if nothing had been.
    with cell.daemon() as daemon:
        assert daemon.stop() == 0
