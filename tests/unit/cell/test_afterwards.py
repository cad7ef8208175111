"""What people read is told in order, in its own context, and never while the robot waits."""

import asyncio
from contextvars import ContextVar

import pytest
import structlog

from slabcell.cell.afterwards import MOMENT_S, Afterwards
from slabcell.cell.events import Offered, StateChanged
from slabcell.cell.states import CellState
from slabcell_drivers.robot.protocol import RequestType

pytestmark = pytest.mark.unit

about: ContextVar[str] = ContextVar("about", default="nothing")


async def test_it_is_done_in_order_soon_and_by_itself():
    afterwards, done = Afterwards(), []
    for number in range(3):
        afterwards.do(lambda number=number: done.append(number))
    assert done == []
    await asyncio.sleep(20 * MOMENT_S)
    assert done == [0, 1, 2]
    afterwards.do(lambda: done.append(3))
    await asyncio.sleep(20 * MOMENT_S)
    assert done == [0, 1, 2, 3]


async def test_catching_up_does_what_is_left_once_and_what_that_brings_about():
    afterwards, done = Afterwards(), []

    def first():
        done.append("first")
        afterwards.do(lambda: done.append("brought about"))

    afterwards.do(first)
    afterwards.do(lambda: done.append("second"))
    afterwards.catch_up()
    assert done == ["first", "second", "brought about"]
    await asyncio.sleep(20 * MOMENT_S)
    assert done == ["first", "second", "brought about"]


async def test_it_is_done_in_the_context_in_which_it_was_given():
    afterwards, seen = Afterwards(), []
    for word in ("job 1", "job 2"):
        about.set(word)
        afterwards.do(lambda: seen.append(about.get()))
    about.set("later")
    afterwards.catch_up()
    assert seen == ["job 1", "job 2"]


async def test_what_raises_is_logged_and_the_rest_is_done():
    afterwards, done = Afterwards(), []
    afterwards.do(lambda: int("no number"))
    afterwards.do(lambda: done.append("rest"))
    with structlog.testing.capture_logs() as lines:
        afterwards.catch_up()
    assert done == ["rest"]
    assert [line["event"] for line in lines] == ["telling failed"]
    afterwards.do(lambda: done.append("next"))
    await asyncio.sleep(20 * MOMENT_S)
    assert done == ["rest", "next"]


def test_without_an_event_loop_it_is_done_at_once():
    afterwards, done = Afterwards(), []
    afterwards.do(lambda: done.append(1))
    assert done == [1]


async def test_the_robot_has_its_answer_before_anybody_is_told_of_it(bench):
    await bench.robot.hello()
    await bench.robot.trigger()
    bench.events.clear()
    offer = (await bench.cell.handle(bench.robot.request(RequestType.NEXT))).offer
    assert bench.events == []
    await bench.cell.settled()
    assert [event.offer.result_id for event in bench.events if isinstance(event, Offered)] == [offer.result_id]


async def test_a_watcher_is_told_of_what_comes_while_it_watches_and_of_nothing_else(bench):
    early, late = [], []
    end = bench.cell.subscribe(early.append)
    await bench.robot.hello()
    await bench.cell.handle(bench.robot.request(RequestType.TRIGGER))
    end()  # what has happened is told first
    bench.cell.subscribe(late.append)
    await bench.cell.settled()
    first = [event.after for event in early if isinstance(event, StateChanged)]
    assert first[:2] == [CellState.ACQUIRING, CellState.LOCATING]
    rest = [event.after for event in late if isinstance(event, StateChanged)]
    every = [event.after for event in bench.events if isinstance(event, StateChanged)]
    assert first + rest == every[-len(first + rest) :]
    assert every[-1] is CellState.OFFERING
