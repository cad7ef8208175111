"""What holds while the ledger still writes the results whose number the robot knows already?"""

import asyncio
import sqlite3
import threading
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from slabcell.cell.states import CellState
from slabcell_drivers.robot.protocol import RequestType, ResultCode

pytestmark = pytest.mark.unit

IN_TIME_S = 5.0


@pytest.fixture
def slow(bench):
    """Return a context within which the ledger writes nothing."""

    @asynccontextmanager
    async def hold():
        go_on = threading.Event()
        held = asyncio.create_task(bench.ledger.run(lambda _: go_on.wait(IN_TIME_S)))
        try:
            yield
        finally:
            go_on.set()
        await held

    return hold


async def told(bench, kind):
    """Return the answer to a request, without waiting for what it brings about."""
    async with asyncio.timeout(IN_TIME_S):
        return await bench.cell.handle(bench.robot.request(kind))


def written(bench):
    """Return the states of all results as another process reads them."""
    with sqlite3.connect(bench.folder / "ledger.sqlite") as book:
        return [state for (state,) in book.execute("SELECT state FROM offers ORDER BY result_id")]


async def test_the_write_begins_when_the_answer_is_taken(bench, monkeypatch):
    order, write = [], bench.ledger.run

    def run(work):
        order.append("write")
        return write(work)

    await bench.robot.hello()
    monkeypatch.setattr(bench.ledger, "run", run)
    await told(bench, RequestType.TRIGGER)
    order.append("answered")
    await bench.cell.settled()
    assert order == ["answered", "write"]


async def test_the_number_of_results_is_told_while_they_are_written_and_the_next_request_waits_for_them(bench, slow):
    await bench.robot.hello()
    async with slow():
        assert (await told(bench, RequestType.TRIGGER)).left == 3
        asking = asyncio.create_task(told(bench, RequestType.NEXT))
        await asyncio.sleep(0.05)
        assert not asking.done()
        assert written(bench) == []
    answer = await asking
    assert (answer.code, answer.left, answer.offer.slot) == (ResultCode.OK, 3, 0)
    assert written(bench) == ["offered", "planned", "planned"]


async def test_a_trigger_that_is_repeated_meanwhile_gets_the_same_answer_and_results_once(bench, slow):
    await bench.robot.hello()
    request = bench.robot.request(RequestType.TRIGGER)
    async with slow():
        first = await bench.cell.handle(request)
        again = asyncio.create_task(bench.cell.handle(request))
        await asyncio.sleep(0.01)
    assert await again == first
    assert bench.camera.snaps == 1
    assert written(bench) == ["offered", "planned", "planned"]


async def test_a_greeting_meanwhile_waits_and_takes_the_results_back(bench, slow):
    await bench.robot.hello()
    async with slow():
        await told(bench, RequestType.TRIGGER)
        greeting = asyncio.create_task(bench.robot.hello())
        await asyncio.sleep(0.01)
        assert not greeting.done()
    assert (await greeting).offer is None
    assert written(bench) == ["void"] * 3
    assert bench.cell.state is CellState.READY


async def test_a_person_who_halts_the_cell_meanwhile_waits_and_has_the_results_taken_back(bench, slow):
    await bench.robot.hello()
    async with slow():
        await told(bench, RequestType.TRIGGER)
        halting = asyncio.create_task(bench.cell.halt("a person"))
        await asyncio.sleep(0.01)
        assert not halting.done()
    await halting
    assert written(bench) == ["void"] * 3
    assert (await bench.robot.next()).offer is None


async def test_stopping_meanwhile_leaves_no_result_that_the_robot_could_act_on(bench, slow):
    await bench.robot.hello()
    async with slow():
        await told(bench, RequestType.TRIGGER)
        stopping = asyncio.create_task(bench.cell.stop())
        await asyncio.sleep(0.01)
    await stopping
    assert written(bench) == ["void"] * 3


async def test_a_write_that_takes_longer_than_the_robot_may_wait_is_no_loss(bench, slow):
    await bench.stop()
    bench.settings = replace(bench.settings, busy_timeout_s=0.05)
    await bench.start()
    await bench.robot.hello()
    async with slow():
        await told(bench, RequestType.TRIGGER)
        assert (await told(bench, RequestType.NEXT)).code == ResultCode.BUSY
    await bench.cell.settled()
    assert (await bench.robot.next()).offer.slot == 0
