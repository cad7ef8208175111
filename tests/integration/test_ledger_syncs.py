"""The ledger pays one sync of the disk for each acknowledgement, and no more: counted in the kernel."""

import os
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.integration

CHILD = """
import sys
from pathlib import Path
from slabcell.cell.ledger import LedgerFile
from slabcell.cell.records import OfferState, Pair
from slabcell_drivers.robot.frame import Frame

book = LedgerFile(Path(sys.argv[1]) / "ledger.sqlite")
job = book.begin_job(1, "squares", "a" * 64, 40)
pose = Frame(1.0, 2.0, 3.0)
offers = book.record_cycle(job.job_id, 1, 1, [Pair(slot, pose, pose, 1.0) for slot in range(40)])
for offer in offers[: int(sys.argv[2])]:
    for state in (OfferState.OFFERED, OfferState.ACCEPTED, OfferState.GRASPED, OfferState.PLACED):
        book.move(offer.result_id, state, session=1, sequence=1)
os = __import__("os")
os._exit(0)  # closing folds the log into the file, which is not what is counted
"""


def syncs(folder, slabs: int) -> int:
    """Return how often the disk was synced while so many slabs were laid."""
    folder.mkdir()
    trace = folder / "trace"
    command = ["strace", "-f", "-qq", "-o", str(trace), "-e", "trace=fdatasync,fsync"]
    subprocess.run([*command, sys.executable, "-c", CHILD, str(folder), str(slabs)], check=True, timeout=100)
    return len(trace.read_text().splitlines())


def test_an_acknowledgement_costs_one_sync_of_the_disk(tmp_path):
    if shutil.which("strace") is None:
        if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
            pytest.fail("strace is not installed: Debian's package of that name has it")
        pytest.skip("strace is not installed")
    few, many = syncs(tmp_path / "few", 5), syncs(tmp_path / "many", 25)
    assert many - few == 4 * 20
