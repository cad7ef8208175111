"""Events reach a client in order, once, from where it left off; a slow one costs nothing but its place."""

import asyncio
import json

import pytest

from slabcell.errors import TemporaryError
from slabcell.service.api.client import ApiClient
from slabcell.service.api.ring import EventRing
from slabcell.service.api.stream import EventStream

pytestmark = pytest.mark.unit


class Reader:
    """Reads a stream of events from the socket."""

    def __init__(self, path):
        self.path = path

    async def open(self, query="", last=None):
        self.reader, self.writer = await asyncio.open_unix_connection(self.path)
        extra = f"last-event-id: {last}\r\n" if last else ""
        self.writer.write(f"GET /v1/events{query} HTTP/1.1\r\nhost: x\r\n{extra}\r\n".encode())
        head = await self.reader.readuntil(b"\r\n\r\n")
        return int(head.split()[1])

    async def event(self):
        fields = {}
        while True:
            line = (await self.reader.readline()).decode().rstrip("\r\n")
            name, _, value = line.partition(": ")
            if name in {"id", "event", "data"}:
                fields[name] = value
            elif not line and "data" in fields:
                return fields["id"], fields["event"], json.loads(fields["data"])

    async def close(self):
        self.writer.close()
        await self.writer.wait_closed()


@pytest.fixture
async def reader(api, tmp_path):
    found = Reader(tmp_path / "api.sock")
    yield found
    await found.close()


async def test_a_client_takes_up_the_stream_where_it_broke_off(api, reader):
    for number in range(5):
        api.ring.add("state", json.dumps({"n": number}))
    first = api.ring.last - 4
    assert await reader.open(last=f"run1-{first}") == 200
    assert [(await reader.event())[2]["n"] for _ in range(4)] == [1, 2, 3, 4]
    api.ring.add("state", json.dumps({"n": 5}))
    assert await reader.event() == (f"run1-{api.ring.last}", "state", {"n": 5})


@pytest.mark.parametrize("last", ["run0-3", "run1-999999", "nonsense", "run1-x"])
async def test_a_client_from_another_run_is_told_to_read_anew(api, reader, last):
    assert await reader.open(last=last) == 200
    assert (await reader.event())[1] == "reset"
    api.ring.add("state", "{}")
    assert (await reader.event())[1] == "state"


async def test_only_the_kinds_that_are_wanted_come_but_ids_go_on(api, reader):
    assert await reader.open("?kinds=alarm") == 200
    api.ring.add("state", "{}")
    api.ring.add("alarm", "{}")
    assert await reader.event() == (f"run1-{api.ring.last}", "alarm", {})


async def test_who_fell_behind_the_ring_is_told_so_and_goes_on_with_what_is_left():
    ring = EventRing("run", kept=10)
    for number in range(25):
        ring.add("state", str(number))
    page = ring.after(3)
    assert page.gap
    assert [item.number for item in page.items] == list(range(16, 26))
    assert not ring.after(15).gap
    assert ring.place_of("run-25") == 25
    assert ring.place_of("run-26") is None


async def test_more_listeners_than_seats_are_refused_and_a_seat_is_free_again(api, reader, tmp_path):
    others = [Reader(tmp_path / "api.sock") for _ in range(2)]
    for other in others:
        assert await other.open() == 200
    assert await reader.open() == 503
    with pytest.raises(TemporaryError, match="2 clients listen already"):
        await asyncio.to_thread(lambda: next(ApiClient(tmp_path / "api.sock").events(stay=False)))
    for other in others:
        await other.close()
    async with asyncio.timeout(10):
        while api.seats.taken:  # noqa: ASYNC110 - the seats are counted, not announced
            await asyncio.sleep(0)
    again = Reader(tmp_path / "api.sock")
    assert await again.open() == 200
    await again.close()


async def test_a_client_that_does_not_read_is_dropped_and_holds_nobody_up(api):
    aborted, began, sent = asyncio.Event(), asyncio.Event(), []

    async def send(message):
        sent.append(message)
        if len(sent) == 2:
            began.set()
        if len(sent) > 2:
            await asyncio.Event().wait()  # its buffers are full, for ever

    async def receive():
        await asyncio.Event().wait()

    stream = EventStream(api.ring, api.seats, after=api.ring.last, gap=False, kinds=(), pause=api.pause, stuck_s=0.05)
    serving = asyncio.create_task(stream({"type": "http", "state": {"abort": aborted.set}}, receive, send))
    await began.wait()
    for _ in range(5000):
        api.ring.add("state", "{}")
    await asyncio.wait_for(serving, 10)
    assert aborted.is_set()
    assert (api.seats.taken, api.seats.dropped) == (0, 1)
    assert len(sent) == 3


async def test_while_a_robot_is_served_nothing_is_told_and_afterwards_all_of_it(api, reader, monkeypatch):
    monkeypatch.setattr("slabcell.service.api.context.LOOKING_WAITS_S", 600.0)
    assert await reader.open() == 200
    with api.cell.leisure.serving():
        for number in range(3):
            api.ring.add("state", json.dumps({"n": number}))
        hearing = asyncio.create_task(reader.event())
        assert not (await asyncio.wait({hearing}, timeout=0.2))[0]
    async with asyncio.timeout(60):
        assert [(await hearing)[2]["n"], *[(await reader.event())[2]["n"] for _ in range(2)]] == [0, 1, 2]


async def test_a_robot_that_is_served_for_long_keeps_events_back_for_a_moment_only(api, reader):
    assert await reader.open() == 200
    with api.cell.leisure.serving():
        api.ring.add("state", json.dumps({"n": 1}))
        async with asyncio.timeout(60):
            assert (await reader.event())[2] == {"n": 1}


async def test_the_streams_end_when_the_daemon_does(api, reader):
    assert await reader.open() == 200
    api.ring.close()
    assert (await reader.reader.read(-1)).endswith(b"0\r\n\r\n")
