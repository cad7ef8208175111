"""Are bundles kept as long as they should be, and no longer?"""

import asyncio
import os
import shutil
from types import SimpleNamespace

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.bundle_store import BundleWriter
from slabcell.cell.events import CycleRecord
from slabcell.cell.retention import Retention, make_room, prune
from slabcell_drivers.camera.protocol import CameraLost

pytestmark = pytest.mark.unit


@pytest.fixture
def folder(tmp_path):
    """Ten bundles of 100 bytes, one a minute, every fifth a failure; the last is of now."""
    for index in range(10):
        kind = "failure" if index % 5 == 0 else "cycle"
        path = tmp_path / f"{index + 1:08d}_20260101T00{index:02d}00.000Z_job1_1-{index}_{kind}.zip"
        path.write_bytes(b"x" * 100)
        os.utime(path, (600.0 * index, 600.0 * index))
    return tmp_path


def left(folder):
    return sorted(int(path.name.split("-")[1].split("_")[0]) for path in folder.iterdir())


def test_the_oldest_go_when_there_are_too_many_bytes(folder):
    prune(folder, Retention(max_bytes=300, max_age_s=1e9), now_s=6000.0, spare=folder / "none")
    assert left(folder) == [0, 5, 7, 8, 9]


def test_failures_have_limits_of_their_own(folder):
    retention = Retention(max_age_s=1e9, failures_max_bytes=100, failures_max_age_s=1e9)
    prune(folder, retention, now_s=6000.0, spare=folder / "none")
    assert left(folder) == [1, 2, 3, 4, 5, 6, 7, 8, 9]


def test_what_is_too_old_goes(folder):
    retention = Retention(max_age_s=1500.0, failures_max_age_s=1e9)
    for _ in range(3):  # a few with each bundle that is written
        prune(folder, retention, now_s=5400.0, spare=folder / "none")
    assert left(folder) == [0, 5, 7, 8, 9]


def test_the_bundle_just_written_stays_even_if_it_alone_is_too_large(folder):
    newest = max(folder.iterdir())
    prune(folder, Retention(max_bytes=10, failures_max_bytes=10), now_s=1e12, spare=newest)
    assert left(folder) == [9]


def test_the_oldest_is_the_one_that_was_written_first_whatever_the_clock_said(folder):
    for path in folder.iterdir():  # as if the clock had been set back ten years after the fifth
        if int(path.name[:8]) > 5:
            path.rename(path.with_name(path.name.replace("_2026", "_2016")))
    prune(folder, Retention(max_bytes=300, max_age_s=1e9), now_s=6000.0, spare=folder / "none")
    assert left(folder) == [0, 5, 7, 8, 9]


def test_a_clock_that_is_years_ahead_costs_a_few_bundles_only(folder):
    gone = prune(folder, Retention(), now_s=1e10, spare=folder / "none")
    assert left(folder) == [3, 4, 6, 7, 8, 9]  # the two oldest that went well, and both failures
    assert len(gone) == 4


def test_bundles_of_what_went_well_make_room_and_failures_stay(folder, monkeypatch):
    room = iter([100, 100, 100, 5000])
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=next(room)))
    make_room(folder, Retention(min_free_bytes=4096))
    assert left(folder) == [0, 4, 5, 6, 7, 8, 9]


async def test_numbers_go_on_and_what_a_dead_process_left_is_tidied_up(bench):
    await bench.stop()
    bench.bundles = True
    (bench.folder / "bundles").mkdir()
    (bench.folder / "bundles" / "00000041_20260101T000000.000Z_job9_9-9_cycle.zip").write_bytes(b"x")
    (bench.folder / "bundles" / "00000042_20260101T000000.000Z_job9_9-9_cycle.part").write_bytes(b"x")
    await bench.start()
    await bench.robot.hello()
    await bench.robot.lay_all()
    await bench.cell.stop()
    assert [path.name[:9] for path in sorted((bench.folder / "bundles").iterdir())] == [
        "00000041_",
        "00000042_",
        "00000043_",
    ]


async def test_a_failed_cycle_is_named_a_failure(bench):
    await bench.stop()
    bench.bundles = True
    await bench.start()
    await bench.robot.hello()
    bench.camera.script.append(CameraLost("gone"))
    await bench.robot.trigger()
    await bench.cell.stop()
    assert [path.name.rpartition("_")[2] for path in (bench.folder / "bundles").iterdir()] == ["failure.zip"]


async def test_a_disk_that_is_nearly_full_is_left_to_the_ledger(bench):
    await bench.stop()
    bench.bundles = True
    bench.retention = Retention(min_free_bytes=1 << 62)
    await bench.start()
    await bench.robot.hello()
    await bench.robot.lay_all()
    await bench.cell.stop()
    assert list((bench.folder / "bundles").iterdir()) == []
    (alarm,) = bench.cell.alarms.standing
    assert alarm.fault is Fault.BUNDLE_UNWRITABLE
    assert "MiB must stay free" in alarm.detail


async def test_bundles_that_cannot_be_written_do_not_stop_the_cell(bench):
    await bench.stop()
    bench.bundles = True
    (bench.folder / "bundles").write_text("a file where the directory should be")
    await bench.start()
    await bench.robot.hello()
    assert (await bench.robot.lay_all()).code == 1
    await bench.cell.stop()
    assert bench.cell.alarms.has(Fault.BUNDLE_UNWRITABLE)


async def test_closing_twice_is_no_error(tmp_path):
    writer = BundleWriter(tmp_path)
    await writer.close()
    await writer.close()


async def test_no_bundle_is_written_while_the_robot_waits(bench):
    await bench.stop()
    bench.bundles = True
    await bench.start()
    writer = bench.cell._cycles._bundles
    written = []
    writer.kept = lambda _, name: written.append(name)
    with writer.leisure.serving():
        writer.keep(CycleRecord(1, 1, 1, 1), bench.cell._cycles._context, {})
        await asyncio.sleep(0.1)
        assert not written
        assert not list(bench.folder.glob("bundles/*"))
    await writer.close()
    assert len(written) == 1
