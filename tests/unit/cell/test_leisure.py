"""Does what can be done later leave its time to the robot, and is it done all the same?"""

import asyncio
import itertools
import threading

import pytest

from slabcell.cell.leisure import Leisure

LONG_S = 600.0
SOON_S = 60.0
"""Far more than anything here takes; a test that passes never waits for it."""


def in_a_thread(leisure, patience_s=LONG_S, urgent=lambda: False):
    thread = threading.Thread(target=leisure.wait, args=[patience_s], kwargs={"urgent": urgent}, daemon=True)
    thread.start()
    return thread


def ended(thread, within_s=SOON_S):
    thread.join(within_s)
    return not thread.is_alive()


def test_with_no_robot_that_waits_there_is_leisure_at_once():
    assert ended(in_a_thread(Leisure()))


def test_there_is_none_while_a_request_is_served_and_there_is_after_it():
    leisure = Leisure()
    with leisure.serving():
        waiting = in_a_thread(leisure)
        assert not ended(waiting, 0.2)
    assert ended(waiting)


@pytest.mark.parametrize("patience_s", [0.0, 0.05])
def test_patience_ends(patience_s):
    leisure = Leisure()
    with leisure.serving():
        assert ended(in_a_thread(leisure, patience_s))


def test_requests_in_a_row_leave_no_leisure_between_them():
    times = itertools.count()
    leisure = Leisure(clock=lambda: next(times) * 1e-6)  # no time passes: the last request was a moment ago
    with leisure.serving():
        pass
    waiting = in_a_thread(leisure)
    assert not ended(waiting, 0.2)
    leisure.end()
    assert ended(waiting)


def test_what_becomes_urgent_waits_no_longer():
    leisure, urgent = Leisure(), threading.Event()
    with leisure.serving():
        waiting = in_a_thread(leisure, urgent=urgent.is_set)
        urgent.set()
        assert ended(waiting)


async def test_who_looks_on_waits_until_the_request_is_served_and_a_moment_longer():
    leisure = Leisure()
    await leisure.pause(LONG_S)  # nobody is served: at once
    with leisure.serving():
        looking = asyncio.create_task(leisure.pause(LONG_S))
        await asyncio.sleep(0.05)
        assert not looking.done()
    with leisure.serving():  # the next one, at once
        await asyncio.sleep(0.05)
        assert not looking.done()
    async with asyncio.timeout(SOON_S):
        await looking


async def test_who_looks_on_does_not_wait_for_ever():
    leisure = Leisure()
    with leisure.serving():
        async with asyncio.timeout(SOON_S):
            await leisure.pause(0.05)


async def test_at_the_end_nobody_waits():
    leisure = Leisure()
    with leisure.serving():
        looking = asyncio.create_task(leisure.pause(LONG_S))
        await asyncio.sleep(0)
        leisure.end()
        async with asyncio.timeout(SOON_S):
            await looking
