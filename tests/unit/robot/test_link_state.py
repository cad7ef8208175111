"""What every link keeps of its state: told once for each change, and pauses that its stop ends."""

import asyncio
import time

import pytest

from slabcell_drivers.robot.link_state import LinkStates, pause
from slabcell_drivers.robot.protocol import LinkState

pytestmark = pytest.mark.unit


def test_a_state_is_told_when_it_changes_and_only_then() -> None:
    told: list[LinkState] = []
    states = LinkStates("eki", told.append)
    assert states.now is LinkState.CLOSED
    for state in (LinkState.CLOSED, LinkState.LISTENING, LinkState.LISTENING, LinkState.CONNECTED):
        states.become(state)
    assert told == [LinkState.LISTENING, LinkState.CONNECTED]
    assert states.now is LinkState.CONNECTED


async def test_a_pause_ends_with_its_time_or_with_the_event() -> None:
    stopping = asyncio.Event()
    began_s = time.monotonic()
    await pause(0.05, unless=stopping)
    assert time.monotonic() - began_s >= 0.04
    waiting = asyncio.ensure_future(pause(3600.0, unless=stopping))
    stopping.set()
    await asyncio.wait_for(waiting, 60)
