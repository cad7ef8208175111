"""A cell that is killed at any instant: is every slab picked at most once for each offer, and laid or recorded?

The cell runs in a process of its own and is killed with SIGKILL at random instants of its jobs; the robot, its memory
and the world are here.  The seed is printed.  Run the long version with ``-m slow``.
"""

import contextlib
import json
import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from slabcell.cell.ledger import LedgerFile
from slabcell_drivers.robot.protocol import AckState, ResultCode

pytestmark = pytest.mark.integration

SLABS = 3
ZYGOTE = Path(__file__).with_name("cell_zygote.py")


class Killed(Exception):  # noqa: N818 - it is no error
    """The cell is gone."""


class Processes:
    """Starts cells and kills them after a random time."""

    def __init__(self, folder: Path, dice: random.Random) -> None:
        self.folder, self.dice = folder, dice
        self.kills = 0
        self.listener = socket.socket(socket.AF_UNIX)
        self.listener.bind(str(folder / "s"))
        self.listener.listen(1)
        self.listener.settimeout(60)
        self.zygote = subprocess.Popen(
            [sys.executable, str(ZYGOTE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.stream = None
        self.timer = None

    def start(self, *, doomed: bool) -> None:
        self.hang_up()
        self.zygote.stdin.write(f"{self.folder / 's'}\t{self.folder}\n")
        self.zygote.stdin.flush()
        pid = int(self.zygote.stdout.readline())
        connection, _ = self.listener.accept()
        connection.settimeout(60)
        self.stream = connection.makefile("rwb")
        connection.close()
        if doomed:
            # Most of a cell's life is its start, some of it work: the instants must fall into both.
            self.timer = threading.Timer(self.dice.uniform(0.0, 0.12), self.kill, [pid])
            self.timer.start()

    def kill(self, pid: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            self.kills += 1

    def ask(self, words: dict) -> dict:
        try:
            self.stream.write(json.dumps(words).encode() + b"\n")
            self.stream.flush()
            line = self.stream.readline()
        except OSError as error:
            raise Killed from error
        if not line.endswith(b"\n"):
            raise Killed
        return json.loads(line)

    def hang_up(self) -> None:
        if self.timer is not None:
            self.timer.cancel()
            self.timer.join()
        if self.stream is not None:
            with contextlib.suppress(OSError):
                self.stream.close()

    def close(self) -> None:
        self.hang_up()
        self.listener.close()
        self.zygote.stdin.close()
        self.zygote.wait(60)
        self.zygote.stdout.close()


class World:
    """A robot that keeps to its rules, and the slabs.  Its memory outlives the cell; acts need an answer first."""

    def __init__(self, processes: Processes) -> None:
        self.processes = processes
        self.where = dict.fromkeys(range(SLABS), "table")
        self.in_slot = {}
        self.result_id, self.ack, self.holds = 0, AckState.NONE, None
        self.session, self.sequence = 0, 0
        self.picks = {}
        self.seen = 0
        self.jobs = 0

    def ask(self, kind: str) -> dict:
        self.sequence += 1
        answer = self.processes.ask(
            {
                "type": kind,
                "session": 0 if kind == "HELLO" else self.session,
                "sequence": self.sequence,
                "result_id": self.result_id,
                "ack": int(self.ack),
                "holds": self.holds is not None,
                "lying": list(self.in_slot.values()),
                "on_table": [slab for slab, place in self.where.items() if place == "table"],
            }
        )
        if kind == "HELLO":
            self.session = answer["session"]
        return answer

    def run_program(self) -> None:
        """Run until the job is complete; raises Killed wherever the cell dies."""
        greeting = self.ask("HELLO")
        assert greeting["code"] == 0
        if greeting["offer"] is not None:
            assert self.holds is not None, "told to place without a part"
            assert greeting["offer"]["result_id"] == self.result_id
            self.place(greeting["offer"]["slot"])
        while True:
            answer = self.ask("TRIGGER")
            if answer["code"] == ResultCode.JOB_COMPLETE:
                return
            assert (answer["code"], answer["left"] > 0) == (0, True), answer
            while answer["left"]:
                offer = self.ask("NEXT")["offer"]
                assert offer["result_id"] > self.seen, "an id that was offered before"
                self.seen = self.result_id = offer["result_id"]
                self.tell(AckState.ACCEPTED)
                self.pick(offer["slot"])
                self.tell(AckState.GRASPED)
                answer = self.place(offer["slot"])

    def tell(self, state: AckState) -> dict:
        self.ack = state  # the robot's memory comes first
        answer = self.ask("ACK")
        assert answer["code"] == 0
        return answer

    def pick(self, slot: int) -> None:
        assert self.holds is None
        assert self.where[slot] == "table", "picked where nothing lies"  # slab n is for slot n
        self.where[slot], self.holds = "hand", slot
        self.picks[self.result_id] = self.picks.get(self.result_id, 0) + 1
        assert self.picks[self.result_id] == 1, "picked twice for one offer"

    def place(self, slot: int) -> dict:
        assert slot not in self.in_slot.values(), "two slabs in one slot"
        self.ack = AckState.PLACED
        self.where[self.holds], self.in_slot[self.holds] = "slot", slot
        self.holds = None
        return self.tell(AckState.PLACED)

    def finish_job(self) -> None:
        assert set(self.where.values()) == {"slot"}
        self.where = dict.fromkeys(range(SLABS), "table")
        self.in_slot.clear()
        self.jobs += 1


def crash(folder: Path, kills: int) -> World:
    seed = random.SystemRandom().randrange(1 << 32)
    sys.stdout.write(f"seed {seed}\n")
    processes = Processes(folder, random.Random(seed))
    world = World(processes)
    try:
        while processes.kills < kills:
            processes.start(doomed=True)
            with contextlib.suppress(Killed):
                while True:
                    world.run_program()
                    world.finish_job()
        processes.start(doomed=False)
        world.run_program()
        world.finish_job()
    finally:
        processes.close()
    return world


def check_ledger(folder: Path, world: World) -> None:
    database = sqlite3.connect(folder / "ledger.sqlite")
    assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()
    book = LedgerFile(folder / "ledger.sqlite")
    offers, jobs = book.rows("offers"), book.rows("jobs")
    book.close()
    # The world's jobs and the ledger's are the same, and so is what lies in them.
    assert [job["state"] for job in jobs] == ["complete"] * world.jobs
    placed = [(offer["job_id"], offer["slot"]) for offer in offers if offer["state"] == "placed"]
    assert sorted(placed) == [(job["job_id"], slot) for job in jobs for slot in range(SLABS)]
    # The robot lost nothing: what is not placed was never begun with, or was never grasped.
    assert {offer["state"] for offer in offers} <= {"placed", "void"}
    assert len([1 for result in world.picks if result]) == len(placed)


def test_a_cell_killed_at_any_instant_lays_every_slab_once(tmp_path):
    world = crash(tmp_path, 25)
    check_ledger(tmp_path, world)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_cell_killed_a_thousand_times_lays_every_slab_once(tmp_path):
    world = crash(tmp_path, 1000)
    check_ledger(tmp_path, world)
