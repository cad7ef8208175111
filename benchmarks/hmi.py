"""How fast are the pages, and what do they cost the cell?

python benchmarks/hmi.py [--cycles 100000] [--looks 40]

Runs the simulated cell and the HMI as processes of their own, with a history and a ledger of so many cycles, and
prints: first paint of the overview in Chromium, the time of history filters, the weight of the pages, the time of a
cycle without and with eight live clients (in turns), and the HMI's memory beside clients that never read.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import socket
import sqlite3
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from urllib.parse import urlsplit

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.hmi.browser import PATHS, opened_browser, window
from tests.hmi.conftest import PASSWORD, Cell, Child, Client, Server, hmi_server

CELL = Path(__file__).parents[1] / "tests" / "hmi" / "cell_process.py"
FIRST = 1000
"""Number of the first cycle that is filled in: the cell's own are below it."""

HMI_NICE = 7
"""Weighs 215 beside 1024, as CPUWeight=20 does beside 100 (table sched_prio_to_weight of Linux)."""


def fill(folder: Path, cycles: int) -> None:
    """Write so many cycles into history and ledger, after the pattern of those that are there; one in 100 failed."""
    with sqlite3.connect(folder / "history.sqlite") as history:
        (text,) = history.execute("SELECT document FROM cycles WHERE verification = 0 LIMIT 1").fetchone()
        document = json.loads(text)

        def rows() -> object:
            for number in range(FIRST, FIRST + cycles):
                code = 1502 if number % 100 == 0 else 0
                began = time.strftime("%Y-%m-%dT%H:%M:%S.000+00:00", time.gmtime(1_700_000_000 + 10 * number))
                job = FIRST + (number - FIRST) // 2
                known = {**document, "cycle": number, "job": job, "code": code, "began": began}
                yield number, job, 0, code, began, json.dumps(known), ""

        history.executemany("INSERT INTO cycles VALUES (?, ?, ?, ?, ?, ?, ?)", rows())
    history.close()
    with sqlite3.connect(folder / "ledger.sqlite", timeout=30) as ledger:
        for table, key in (("jobs", "job_id"), ("offers", "result_id")):
            columns = [row[1] for row in ledger.execute(f"PRAGMA table_info({table})")]
            first = ledger.execute(f"SELECT * FROM {table} LIMIT 1").fetchone()  # noqa: S608 - two names
            pattern = dict(zip(columns, first, strict=True))
            each = 1 if table == "jobs" else 5
            lines = (
                [
                    {**pattern, key: FIRST + index, "job_id": FIRST + index // each, "slot": index % each}[name]
                    for name in columns
                ]
                for index in range(cycles // 2 * each)
            )
            marks = ", ".join("?" * len(columns))
            ledger.executemany(f"INSERT INTO {table} VALUES ({marks})", lines)  # noqa: S608 - two names
    ledger.close()


def first_paint(server: Server) -> None:
    """Print when the overview is painted first, and when it is complete, picture included."""
    with opened_browser() as browser:
        paints: list[float] = []
        complete: list[float] = []
        for _ in range(5):
            with window(browser, server, "admin") as page:
                page.goto("/")
                page.locator("slab-picture .stage").wait_for()
                script = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
                paints.append(page.evaluate(script))
                complete.append(page.evaluate("performance.now()"))
        said = f"overview: first contentful paint {statistics.median(paints):.0f} ms (of {sorted(map(round, paints))})"
        print(f"{said}, with its picture {statistics.median(complete):.0f} ms")
        with window(browser, server, "admin") as page:
            sizes: list[int] = []
            page.on("response", lambda answer: sizes.append(_weight(answer.headers)))
            weights: list[int] = []
            for path in PATHS:
                sizes.clear()
                page.goto(path, wait_until="load")
                weights.append(sum(sizes))
        print(f"weight of the heaviest page without pictures: {max(weights) / 1000:.0f} kB")


def _weight(headers: dict[str, str]) -> int:
    return 0 if headers.get("content-type", "").startswith("image/") else int(headers.get("content-length", 0))


def filters(client: Client) -> None:
    """Print how long each filter of the history takes."""
    for query in (
        "",
        "failed=1",
        "code=1502",
        "code=1101",
        "job=1500",
        "until=2024-01-01T00:00",
        "before=2000&failed=1",
    ):
        times: list[float] = []
        for _ in range(10):
            began = time.perf_counter()
            answer = client.get(f"/history/rows?{query}")
            times.append(1000 * (time.perf_counter() - began))
            assert answer.status == 200, answer.text
        print(
            f"history filter {query or 'none':26} median {statistics.median(times):6.1f} ms, worst {max(times):6.1f} ms"
        )


class Viewer(threading.Thread):
    """A page that shows the live picture, as fast as it gets it."""

    def __init__(self, client: Client) -> None:
        super().__init__(daemon=True)
        cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
        address = f"ws://{urlsplit(client.base).netloc}/live"
        self._open = ExitStack()
        self._socket = self._open.enter_context(
            connect(address, additional_headers={"Cookie": cookie}, origin=client.base, max_size=None)
        )
        self.pictures = 0

    def run(self) -> None:
        """Ask for a picture each time that one has come."""
        with suppress(ConnectionClosed):  # it is closed while it looks
            self._socket.send("picture")
            for message in self._socket:
                if isinstance(message, bytes):
                    self.pictures += 1
                    self._socket.send("picture")

    def end(self) -> None:
        """Close the page."""
        self._open.close()
        self.join()


class Viewers:
    """Pages in a process of their own, of the lowest priority: a page is on another machine, and takes no time here."""

    def __init__(self, client: Client) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_view, args=(client, theirs), daemon=True)
        self._process.start()

    def open(self, pages: int) -> None:
        """Open so many pages."""
        self._pipe.send(pages)
        self._pipe.recv()

    def close(self) -> int:
        """Close them; return how many pictures they showed."""
        self._pipe.send(0)
        return self._pipe.recv()

    def end(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(60.0)


def _view(client: Client, pipe: Connection) -> None:
    os.nice(19)
    viewers: list[Viewer] = []
    with suppress(EOFError):
        while True:
            pages = pipe.recv()
            for viewer in viewers:
                viewer.end()
            shown = sum(viewer.pictures for viewer in viewers)
            viewers = [Viewer(client) for _ in range(pages)]
            for viewer in viewers:
                viewer.start()
            pipe.send(shown)


def live(cell: Cell, client: Client, looks: int) -> None:
    """Print the time of a cycle with nobody looking and with eight pages, in turns."""
    total: dict[bool, list[float]] = {False: [], True: []}
    work: dict[bool, list[float]] = {False: [], True: []}
    shown = 0
    viewers = Viewers(client)
    for index in range(looks):
        watched = index % 2 == 1
        viewers.open(8 if watched else 0)
        for _ in range(3):
            times = cell.api.post("/v1/trigger")["times_ms"]
            total[watched].append(times["total"])
            work[watched].append(times["total"] - times["acquire"])
        shown += viewers.close()
    viewers.end()
    for name, found in (("cycle", total), ("cycle without taking the picture", work)):
        alone, beside = statistics.median(found[False]), statistics.median(found[True])
        pairs = [100 * (b / a - 1) for a, b in zip(found[False], found[True], strict=True)]
        change = f"{100 * (beside / alone - 1):+.1f} %, median of {len(pairs)} pairs {statistics.median(pairs):+.1f} %"
        print(f"{name}: {alone:.1f} ms alone, {beside:.1f} ms with 8 live clients: {change}; {shown} pictures shown")


def deaf(cell: Cell, server: Server, client: Client, looks: int) -> None:
    """Print the HMI's memory before and after eight clients have asked for pictures and read nothing."""
    status = Path(f"/proc/{server.child.process.pid}/status")

    def rss_mib() -> float:
        line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
        return int(line.split()[1]) / 1024

    host, port = urlsplit(client.base).netloc.split(":")
    cookie = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
    head = (
        f"GET /live HTTP/1.1\r\nHost: {host}:{port}\r\nOrigin: {client.base}\r\nCookie: {cookie}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
    masked = bytes([0x81, 0x80 | 7, 0, 0, 0, 0]) + b"picture"
    cell.api.post("/v1/trigger")
    before = rss_mib()
    sockets: list[socket.socket] = []
    for _ in range(8):
        one = socket.create_connection((host, int(port)))
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        one.sendall(head.encode() + masked * 50)
        sockets.append(one)
    most = before
    for _ in range(looks):
        cell.api.post("/v1/trigger")
        most = max(most, rss_mib())
    memory = f"{before:.1f} MiB before, {most:.1f} MiB at most, {rss_mib():.1f} MiB after"
    print(f"8 clients that never read, {looks} pictures: the HMI has {memory}")
    for one in sockets:
        one.close()


def yield_to_the_cell(server: Server) -> None:
    """Give the HMI the share of a processor that its unit gives it (CPUWeight=20), which here is a nice value."""
    for thread in Path(f"/proc/{server.child.process.pid}/task").iterdir():
        os.setpriority(os.PRIO_PROCESS, int(thread.name), os.getpriority(os.PRIO_PROCESS, 0) + HMI_NICE)


@contextmanager
def simulated_cell() -> Iterator[tuple[Cell, Path]]:
    """Run a simulated cell in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="slabcell-") as name:
        folder = Path(name)
        child = Child([sys.executable, str(CELL), name, "dresden", "5", "0"], folder / "cell.log")
        try:
            yield Cell(child, Path(child.line().partition(" ")[2]), folder), folder
        finally:
            child.end()


def first_user(server: Server) -> Client:
    """Return the administrator that the first-start token makes, logged in."""
    client = Client(server.base)
    client.post("/first", {"token": server.token, "name": "admin", "password": PASSWORD, "again": PASSWORD})
    client.get("/")
    return client


def main() -> None:
    """Run it all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=int, default=100_000)
    parser.add_argument("--looks", type=int, default=40)
    options = parser.parse_args()
    with simulated_cell() as (cell, folder):
        cell.lay()
        fill(folder, options.cycles)
        with hmi_server(cell.socket, folder, SLABCELL__HMI__LIVE_CLIENTS="64") as server:
            client = first_user(server)
            yield_to_the_cell(server)
            print(f"{options.cycles} cycles in history and ledger")
            first_paint(server)
            filters(client)
            cell.tell("strew")
            live(cell, client, options.looks)
            deaf(cell, server, client, 30)


if __name__ == "__main__":
    main()
