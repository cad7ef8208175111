"""A state directory that cannot be written is named, and forgotten about when it can be written again."""

import asyncio
from pathlib import Path

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.alarms import Alarms
from slabcell.service import disk_watch
from slabcell.service.disk_watch import DiskWatch
from slabcell.service.links import LinkName, Links, LinkState

pytestmark = pytest.mark.unit


def test_a_lost_disk_is_named_within_two_seconds_by_the_times_it_goes_by():
    assert disk_watch.EVERY_S + disk_watch.ANSWERS_WITHIN_S <= 2.0


async def test_a_disk_that_is_lost_and_comes_back_is_named_and_forgotten(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(disk_watch, "EVERY_S", 0.01)
    folder, away = tmp_path / "state", tmp_path / "away"
    folder.mkdir()
    links, alarms = Links(), Alarms(lambda _: None)
    watching = asyncio.create_task(DiskWatch(folder, alarms, links).run())

    async def until(state: LinkState) -> None:
        async with asyncio.timeout(60):
            while links[LinkName.DISK].state is not state:  # noqa: ASYNC110 - a state
                await asyncio.sleep(0.005)

    await until(LinkState.UP)
    folder.rename(away)
    await until(LinkState.DOWN)
    assert f"{folder}: cannot be written: No such file" in links[LinkName.DISK].detail
    assert alarms.has(Fault.STATE_UNWRITABLE)
    away.rename(folder)
    await until(LinkState.UP)
    assert not alarms.has(Fault.STATE_UNWRITABLE)
    watching.cancel()
    await asyncio.gather(watching, return_exceptions=True)


async def test_a_disk_that_does_not_answer_is_named(tmp_path: Path, monkeypatch):
    import threading

    answers = threading.Event()
    monkeypatch.setattr(disk_watch, "EVERY_S", 0.01)
    monkeypatch.setattr(disk_watch, "ANSWERS_WITHIN_S", 0.05)
    monkeypatch.setattr(disk_watch, "_probe", lambda _: answers.wait(60))
    links, alarms = Links(), Alarms(lambda _: None)
    watching = asyncio.create_task(DiskWatch(tmp_path, alarms, links).run())
    async with asyncio.timeout(60):
        while links[LinkName.DISK].state is not LinkState.DOWN:  # noqa: ASYNC110 - a state
            await asyncio.sleep(0.005)
    assert "no answer within" in links[LinkName.DISK].detail
    answers.set()
    async with asyncio.timeout(60):
        while links[LinkName.DISK].state is not LinkState.UP:  # noqa: ASYNC110 - a state
            await asyncio.sleep(0.005)
    watching.cancel()
    await asyncio.gather(watching, return_exceptions=True)
