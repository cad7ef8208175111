"""Parts of the daemon that fail or come late: nothing is silent, and nothing ends for want of an address."""

import asyncio
import contextlib
import errno
from pathlib import Path

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.ledger import LedgerError, LedgerFile
from slabcell.cell.records import JobState
from slabcell.errors import SlabcellError
from slabcell.service import robot_link
from slabcell.service.api.client import ApiClient
from slabcell.service.daemon import _beside
from slabcell.service.light_config import LightReport
from slabcell.service.links import LinkName, Links, LinkState
from slabcell.service.metrics import Metrics
from slabcell.service.robot_watch import RobotWatch
from slabcell_drivers.robot.eki.link import EkiServer

pytestmark = pytest.mark.unit


async def fail() -> None:
    await asyncio.sleep(0)
    raise ValueError("the part is broken")


async def last(done: list[str]) -> None:
    try:
        await asyncio.Event().wait()
    finally:
        done.append("ended")


async def test_a_part_that_fails_ends_the_daemon_in_order_and_is_named():
    done: list[str] = []

    async def block() -> None:
        async with _beside(fail(), last(done)):
            try:
                await asyncio.Event().wait()
            finally:
                done.append("closed")

    with pytest.raises(SlabcellError, match="slabcell-fail ended: ValueError: the part is broken") as caught:
        await block()
    assert done == ["closed", "ended"]
    assert caught.value.number == Fault.INTERNAL
    await asyncio.sleep(0)  # the task itself is not cancelled any more


async def test_parts_end_with_the_block_and_a_cancelled_block_stays_cancelled():
    done: list[str] = []
    async with _beside(last(done)):
        await asyncio.sleep(0)
    assert done == ["ended"]

    async def block() -> None:
        async with _beside(last(done)):
            await asyncio.Event().wait()

    task = asyncio.create_task(block())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


class LateServer(EkiServer):
    """Its address is there at the third attempt."""

    attempts = 0

    async def start(self, handler) -> None:
        self.attempts += 1
        if self.attempts < 3:
            raise OSError(errno.EADDRNOTAVAIL, "Cannot assign requested address")
        await super().start(handler)


async def test_an_address_that_comes_later_is_waited_for_and_the_link_says_so(api, monkeypatch):
    monkeypatch.setattr(robot_link, "ADDRESS_EVERY_S", 0.01)
    told: list[tuple[LinkState, str]] = []
    api.links.changed = lambda link: told.append((link.state, link.detail))
    robot: RobotWatch = api.robot
    link = LateServer("127.0.0.1", 0, on_state=robot.link_changed)
    async with robot_link._started_later(link, robot.handle, robot, ("192.0.2.1", 54600)), asyncio.timeout(60):
        while api.links[LinkName.ROBOT].state is not LinkState.CONNECTING or link.attempts < 3:  # noqa: ASYNC110
            await asyncio.sleep(0.005)
        assert "waiting for the robot at 127.0.0.1" in api.links[LinkName.ROBOT].detail
    assert told[0] == (
        LinkState.DOWN,
        "192.0.2.1:54600 is not this PC's address yet: Cannot assign requested address",
    )


async def test_peers_that_are_turned_away_are_counted_in_status_and_metrics(api, tmp_path):
    link = EkiServer("127.0.0.1", 0, allowed_hosts=frozenset({"192.0.2.7"}), on_state=api.robot.link_changed)
    await link.start(api.robot.handle)
    api.robot.meets_at(*link.address, link)
    for _ in range(2):
        reader, writer = await asyncio.open_connection(*link.address)
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()
    client = ApiClient(tmp_path / "api.sock")
    assert (await asyncio.to_thread(client.get, "/v1/status"))["refused_peers"] == 2
    text = Metrics(api, None).text().decode()
    assert "slabcell_robot_peers_refused_total 2.0" in text
    await link.stop()


def test_a_light_is_among_the_links_of_a_cell_that_has_one(api_alarms):
    assert LinkName.LIGHT not in {link.name for link in Links().all}
    links, report = Links(light=True), LightReport()
    assert links[LinkName.LIGHT].state is LinkState.CONNECTING
    report.told("no answer")
    report.tell_to(api_alarms, links)
    assert (links[LinkName.LIGHT].state, links[LinkName.LIGHT].detail) == (LinkState.DOWN, "no answer")
    assert api_alarms.has(Fault.LIGHT_LOST)
    report.told("")
    assert links[LinkName.LIGHT].state is LinkState.UP
    assert not api_alarms.has(Fault.LIGHT_LOST)


@pytest.fixture
def api_alarms():
    from slabcell.cell.alarms import Alarms

    return Alarms(lambda _: None)


def test_a_copy_of_the_ledger_is_read_beside_a_writer_and_leaves_the_file_alone(tmp_path: Path):
    path = tmp_path / "ledger.sqlite"
    writer = LedgerFile(path)
    job = writer.begin_job(1, "squares", "a" * 64, 3)
    with writer.step():
        writer.end_job(job.job_id, JobState.COMPLETE)  # not durable yet
        copy = LedgerFile(path, copy=True)
        assert [row["state"] for row in copy.rows("jobs")] == ["open"]
        copy.end_job(job.job_id, JobState.ABANDONED)  # in the copy
        copy.close()
    assert [row["state"] for row in writer.rows("jobs")] == ["complete"]
    writer.close()
    (tmp_path / "none.sqlite").write_bytes(b"no ledger" * 100)
    with pytest.raises(LedgerError, match=r"none\.sqlite"):
        LedgerFile(tmp_path / "none.sqlite", copy=True)
    with pytest.raises(LedgerError):
        LedgerFile(tmp_path / "nowhere.sqlite", copy=True)
    assert not (tmp_path / "nowhere.sqlite").exists()
