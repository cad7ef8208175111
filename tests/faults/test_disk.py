"""The disk is full, read-only, in use or fails to sync: is nothing offered that could not be written down first?"""

import json
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.ledger import LedgerFile
from slabcell.cell.retention import Retention
from slabcell.cell.states import CellState
from slabcell_drivers.robot.protocol import AckState

from .confinement import missing

pytestmark = [pytest.mark.faults, pytest.mark.timeout(180)]

CHILD = Path(__file__).with_name("cell_child.py")


async def lay_until_refused(robot) -> int:
    """Lay slabs until the cell answers with an error of the catalogue; return its number."""
    while True:
        answer = await robot.trigger()
        while answer.left > 0 and answer.code == 0:
            offered = await robot.next()
            if offered.code:
                return offered.code
            for state in (AckState.ACCEPTED, AckState.GRASPED, AckState.PLACED):
                answer = await robot.say(state, offered.offer.result_id)
                if answer.code:
                    return answer.code
        if answer.code > 1000:
            return answer.code


def check(folder: Path) -> list[dict]:
    """Open the ledger as the next start does; return its results."""
    database = sqlite3.connect(folder / "ledger.sqlite")
    assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    database.close()
    book = LedgerFile(folder / "ledger.sqlite")
    offers = book.rows("offers")
    book.close()
    return offers


async def test_on_a_full_disk_nothing_is_offered_and_the_job_goes_on_when_there_is_room(make_bench, small_disk):
    bench = make_bench(small_disk.folder)
    await bench.start()
    await bench.robot.hello()
    first = (await bench.robot.trigger()).left
    assert first == 3
    small_disk.fill()
    assert await lay_until_refused(bench.robot) == Fault.DISK_FULL
    assert bench.cell.state is CellState.ERROR
    assert bench.cell.alarms.has(Fault.DISK_FULL)
    assert (await bench.robot.trigger()).code == Fault.DISK_FULL  # until somebody has made room and says so
    small_disk.free()
    await bench.cell.clear()
    assert bench.cell.alarms.has(Fault.DISK_FULL) is None
    # The robot's memory is ahead of the ledger by the word that could not be written: its greeting settles that.
    await bench.robot.hello()
    bench.robot.holds = False
    await bench.robot.hello()
    for offer in await bench.cell._desk.unknown():
        await bench.cell.resolve(offer.result_id, placed=False)
    assert (await bench.robot.lay_all()).code == 1
    await bench.stop()
    offers = check(small_disk.folder)
    placed = [offer["slot"] for offer in offers if offer["state"] == "placed"]
    assert sorted(placed) == [0, 1, 2]
    assert {offer["state"] for offer in offers} <= {"placed", "void", "failed"}


async def test_a_full_disk_costs_the_bundles_and_not_the_job(make_bench, small_disk):
    bench = make_bench(small_disk.folder)
    bench.bundles, bench.retention = True, Retention(min_free_bytes=1 << 21)
    await bench.start()
    (small_disk.folder / "other").write_bytes(b"x" * (1 << 21))
    await bench.robot.hello()
    assert (await bench.robot.lay_all()).code == 1
    await bench.cell._cycles.close()
    assert bench.cell.alarms.has(Fault.BUNDLE_UNWRITABLE)
    assert list((small_disk.folder / "bundles").iterdir()) == []
    await bench.stop()
    assert len([offer for offer in check(small_disk.folder) if offer["state"] == "placed"]) == 3


async def test_a_disk_that_turns_read_only_stops_the_cell_by_number_and_loses_nothing(make_bench, small_disk):
    bench = make_bench(small_disk.folder)
    await bench.start()
    await bench.robot.hello()
    await bench.robot.lay((await lay_first(bench)).result_id)
    await bench.ledger.run(lambda book: book.tidy())
    await bench.ledger.close()
    small_disk.may_be_written(yes=False)
    try:
        with pytest.raises(Exception, match=r"cannot be written|read-only|readonly") as caught:
            await bench.start()
        assert getattr(caught.value, "number", None) == Fault.LEDGER_UNWRITABLE
    finally:
        small_disk.may_be_written(yes=True)
    assert [offer["state"] for offer in check(small_disk.folder)].count("placed") == 1
    await bench.cell.stop()


async def lay_first(bench):
    await bench.robot.trigger()
    return (await bench.robot.next()).offer


async def test_a_folder_that_may_not_be_entered_is_named_before_anything_runs(make_bench, tmp_path):
    bench = make_bench(tmp_path / "nothing" / "there")
    with pytest.raises(Exception, match="check that the directory exists and may be written") as caught:
        await bench.start()
    assert caught.value.number == Fault.LEDGER_UNWRITABLE


async def test_a_ledger_that_another_process_holds_is_named(make_bench, tmp_path):
    bench = make_bench(tmp_path)
    await bench.start()
    await bench.robot.hello()
    script = (
        "import sqlite3, sys\nbook = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        "book.execute('BEGIN IMMEDIATE')\nprint('held', flush=True)\nsys.stdin.read()\n"
    )
    with subprocess.Popen(  # noqa: ASYNC220 - it only holds the file
        [sys.executable, "-c", script, str(tmp_path / "ledger.sqlite")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout.readline() == "held\n"
        await bench.robot.trigger()
        assert (await bench.robot.next()).code == Fault.LEDGER_IN_USE
        holder.stdin.close()
    await bench.cell.clear()
    assert (await bench.robot.trigger()).left == 3
    await bench.stop()


@pytest.mark.parametrize("when", [1, 2, 4, 7, 10, 13])
def test_a_sync_that_fails_is_no_acknowledgement(tmp_path, when):
    """The disk fails at one of the syncs of a job, and at every later one: strace makes the kernel say EIO."""
    if shutil.which("strace") is None:
        missing("strace is not installed: Debian's package strace has it")
    LedgerFile(tmp_path / "ledger.sqlite").close()  # its creation needs syncs of its own
    inject = f"inject=fdatasync,fsync:error=EIO:when={when}+"
    traced = ["strace", "-f", "-qq", "-o", str(tmp_path / "trace"), "-e", "trace=fdatasync,fsync", "-e", inject]
    done = subprocess.run(
        [*traced, sys.executable, str(CHILD), str(tmp_path)], capture_output=True, text=True, check=False, timeout=120
    )
    if "ptrace" in done.stderr and "not permitted" in done.stderr:
        pytest.skip(f"processes may not be traced here: {done.stderr.strip()[-200:]}")
    assert done.returncode == 0, done.stderr
    said = [json.loads(line) for line in done.stdout.splitlines()]
    assert said, "the child said nothing"
    assert said[-1]["code"] == Fault.LEDGER_UNWRITABLE
    assert all(answer["code"] == 0 for answer in said[:-1])
    # What was answered well is in the ledger, as it was answered; what was not answered is at most one step.
    offers = {offer["result_id"]: offer["state"] for offer in check(tmp_path)}
    acknowledged = {answer["result"]: answer["said"] for answer in said[:-1] if answer["said"]}
    for result_id, state in acknowledged.items():
        assert offers[result_id] in {state, next_step(state)}
    # The next start goes on.
    again = subprocess.run([sys.executable, str(CHILD), str(tmp_path)], capture_output=True, text=True, check=True)
    assert json.loads(again.stdout.splitlines()[-1])["code"] == 1


def next_step(state: str) -> str:
    steps = ["accepted", "grasped", "placed"]
    return steps[min(steps.index(state) + 1, 2)]
