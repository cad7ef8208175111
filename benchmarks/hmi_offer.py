"""Do pages that show live pictures slow the robot?  TRIGGER to first offer over the robot link, alone and watched.

python benchmarks/hmi_offer.py [--pairs 60] [--pages 8]

The simulated cell and the HMI are processes of their own; the robot is a socket that speaks EKI: HELLO, then TRIGGER
and NEXT until an offer comes.  Nothing is acknowledged, so that every picture shows the same slabs.  Each pair is one
measurement with nobody looking and one beside so many pages that show every picture, in an order drawn anew.  The
pages' HMI takes its time from the same processor, with the priority of its unit; the pages are on other machines in a
cell, and have the lowest priority here.  Taking the picture is rendering here, so both are given: the whole way, and
what is left when the time that the cell says for the picture is taken off.
"""

from __future__ import annotations

import argparse
import random
import socket
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.hmi import Viewers, first_user, simulated_cell, yield_to_the_cell
from tests.hmi.conftest import Cell, hmi_server

from slabcell_drivers.robot.eki.codec import decode_answer, encode_request
from slabcell_drivers.robot.protocol import Answer, Request, RequestType

LIMIT_S = 60.0
SETTLE_S = 1.5
"""Until the bundle of the cycle before is written; the robot drives meanwhile."""


class Robot:
    """The robot's end of the link."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), LIMIT_S)
        self._session = self._sequence = 0

    def ask(self, kind: RequestType) -> Answer:
        """Send one telegram and return the answer to it."""
        self._sequence += 1
        session = 0 if kind is RequestType.HELLO else self._session
        self._socket.sendall(encode_request(Request(kind, session, self._sequence)))
        heard = b""
        while not heard.endswith(b"</Vis>"):
            more = self._socket.recv(4096)
            assert more, f"the link ended after {heard!r}"
            heard += more
        answer = decode_answer(heard)
        self._session = answer.session
        return answer

    def first_offer_ms(self) -> float:
        """Return the time from TRIGGER to the first offer."""
        self.ask(RequestType.HELLO)
        began = time.perf_counter()
        left = self.ask(RequestType.TRIGGER).left
        offer = self.ask(RequestType.NEXT).offer
        taken_ms = 1e3 * (time.perf_counter() - began)
        assert left, "the picture showed no slab"
        assert offer is not None
        return taken_ms

    def close(self) -> None:
        """Leave."""
        self._socket.close()


def measure(cell: Cell, robot: Robot, viewers: Viewers, pages: int, *, watched: bool) -> tuple[float, float, int]:
    """Return the time to the first offer, the same without taking the picture, in ms, and the pictures shown.

    Pages are opened either way, and closed before the trigger if nobody is to look: the cell has the same time for
    what the cycle before has left it to do.
    """
    viewers.open(pages)
    shown = 0 if watched else viewers.close()
    time.sleep(SETTLE_S)
    offer_ms = robot.first_offer_ms()
    if watched:
        shown = viewers.close()
    robot.ask(RequestType.HELLO)  # voids what was offered, and ends the cycle: its times are known then
    times = cell.api.get("/v1/cycles", limit=1)["cycles"][0]["times_ms"]
    return offer_ms, offer_ms - times["acquire"], shown


def report(name: str, alone: Sequence[float], beside: Sequence[float], pages: int) -> None:
    """Print one comparison, with an interval for the median that holds in 95 of 100 repetitions (by resampling)."""
    changes = [100.0 * (b / a - 1.0) for a, b in zip(alone, beside, strict=True)]
    dice = random.Random(1)
    again = sorted(statistics.median(dice.choices(changes, k=len(changes))) for _ in range(2000))
    print(
        f"{name}: median {statistics.median(alone):.1f} ms alone, {statistics.median(beside):.1f} ms beside {pages}"
        f" pages; median of {len(changes)} pairs {statistics.median(changes):+.1f} %"
        f" (95 %: {again[50]:+.1f} to {again[-51]:+.1f} %)"
    )


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=60)
    parser.add_argument("--pages", type=int, default=8)
    options = parser.parse_args()
    whole: dict[bool, list[float]] = {False: [], True: []}
    rest: dict[bool, list[float]] = {False: [], True: []}
    shown = 0
    with simulated_cell() as (cell, folder):
        host, port = cell.tell("link").split()
        with hmi_server(cell.socket, folder, SLABCELL__HMI__LIVE_CLIENTS="64") as server:
            viewers = Viewers(first_user(server))
            yield_to_the_cell(server)
            robot = Robot(host, int(port))
            for _ in range(5):  # caches fill
                measure(cell, robot, viewers, 0, watched=False)
            for _ in range(options.pairs):
                for watched in random.sample([False, True], 2):
                    offer_ms, rest_ms, pictures = measure(cell, robot, viewers, options.pages, watched=watched)
                    whole[watched].append(offer_ms)
                    rest[watched].append(rest_ms)
                    shown += pictures
            robot.close()
            viewers.end()
    report("trigger to first offer", whole[False], whole[True], options.pages)
    report("the same without taking the picture", rest[False], rest[True], options.pages)
    print(f"{shown} pictures were shown")


if __name__ == "__main__":
    main()
