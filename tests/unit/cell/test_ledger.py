"""Does the ledger keep what it was told, and refuse what must not be?"""

import itertools
import sqlite3
import threading

import pytest

from slabcell.catalogue import Fault
from slabcell.cell.ledger import Ledger, LedgerError, LedgerFile
from slabcell.cell.records import STEPS, JobState, OfferState, Pair, PlacementRecord
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit

PAIRS = [Pair(slot, Frame(slot, 2, 3, 4, 0, 180), Frame(5, 6, slot, 7, 0, 180), 0.9) for slot in range(3)]


@pytest.fixture
def book(tmp_path):
    file = LedgerFile(tmp_path / "ledger.sqlite", now=lambda: "2026-01-01T00:00:00.000+00:00")
    yield file
    file.close()


def begin(book):
    job = book.begin_job(0, "squares", "a" * 64, 3)
    return job, book.record_cycle(job.job_id, book.new_session("test"), 1, PAIRS)


def test_what_is_written_is_read_back(book):
    job, offers = begin(book)
    assert book.offers(job.job_id) == offers
    assert [(offer.slot, offer.pick, offer.place) for offer in offers] == [(p.slot, p.pick, p.place) for p in PAIRS]
    assert book.last_job() == job


def test_every_commit_reaches_the_disk(book):
    pragmas = {name: book._db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("journal_mode", "synchronous")}
    assert pragmas == {"journal_mode": "wal", "synchronous": 2}


def test_an_acknowledgement_is_one_transaction(book):
    _, offers = begin(book)
    statements = []
    book._db.set_trace_callback(statements.append)
    book.move(offers[0].result_id, OfferState.OFFERED)
    assert statements.count("COMMIT") == 1


def test_result_ids_rise_over_restarts_even_if_rows_are_gone(tmp_path):
    path = tmp_path / "ledger.sqlite"
    highest = 0
    for _ in range(3):
        book = LedgerFile(path)
        job, offers = begin(book)
        assert min(offer.result_id for offer in offers) > highest
        highest = max(offer.result_id for offer in offers)
        book.void(job.job_id, reason="test")
        book.end_job(job.job_id, JobState.ABANDONED)
        book._db.execute("DELETE FROM acknowledgements")
        book._db.execute("DELETE FROM offers")
        book.close()


def test_result_ids_stay_above_what_a_robot_remembers(book):
    book.keep_above(5000)
    book.keep_above(10)
    _, offers = begin(book)
    assert [offer.result_id for offer in offers] == [5001, 5002, 5003]


def test_only_the_steps_of_the_table_are_taken(book):
    _, (offer, *_) = begin(book)
    for before, after in itertools.product(OfferState, OfferState):
        book._db.execute("UPDATE offers SET state = ? WHERE result_id = ?", (before.value, offer.result_id))
        if after is before or after in STEPS[before]:
            assert book.move(offer.result_id, after).state is after
        else:
            with pytest.raises(LedgerError, match=f"is {before} and cannot become {after}"):
                book.move(offer.result_id, after)
            assert book.offer(offer.result_id).state is before


def test_a_slot_is_not_given_to_two_slabs(book):
    job, _ = begin(book)
    with pytest.raises(LedgerError, match="UNIQUE"):
        book.record_cycle(job.job_id, book.new_session("again"), 2, PAIRS[:1])
    assert len(book.offers(job.job_id)) == 3


def test_two_slabs_are_not_in_one_hand(book):
    _, (first, second, _) = begin(book)
    for offer in (first, second):
        book.move(offer.result_id, OfferState.OFFERED)
    book.move(first.result_id, OfferState.GRASPED)
    with pytest.raises(LedgerError, match="UNIQUE"):
        book.move(second.result_id, OfferState.ACCEPTED)


def test_one_trigger_is_one_cycle(book):
    job = book.begin_job(0, "squares", "a" * 64, 3)
    book.record_cycle(job.job_id, 1, 1, PAIRS[:1])
    with pytest.raises(LedgerError, match="UNIQUE"):
        book.record_cycle(job.job_id, 1, 1, PAIRS[1:])


def test_a_failed_write_leaves_nothing_half_done(book):
    job, _ = begin(book)
    with pytest.raises(LedgerError):
        book.record_cycle(job.job_id, 77, 5, [*PAIRS[:1]])
    assert not [row for row in book.rows("cycles") if row["session"] == 77]
    assert not book._db.in_transaction


def test_voiding_takes_back_only_what_was_not_begun(book):
    job, (first, second, third) = begin(book)
    book.move(first.result_id, OfferState.OFFERED)
    book.move(first.result_id, OfferState.GRASPED)
    book.move(second.result_id, OfferState.OFFERED)
    assert book.void(job.job_id, reason="test") == [second.result_id, third.result_id]
    assert book.offer(first.result_id).state is OfferState.GRASPED


def test_an_unknown_result_is_an_error_with_its_number(book):
    with pytest.raises(LedgerError, match="result 99 is not in the ledger") as caught:
        book.move(99, OfferState.OFFERED)
    assert caught.value.number == Fault.LEDGER_ERROR


def test_placements_are_kept(book):
    job, _ = begin(book)
    book.record_placements(job.job_id, [PlacementRecord(0, True, 0.1, -0.2, 0.3, 0.02)])
    (row,) = book.rows("placements", job.job_id)
    assert (row["slot"], row["dx_mm"], row["dy_mm"]) == (0, 0.1, -0.2)


def test_a_file_that_is_no_ledger_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "ledger.sqlite"
    path.write_bytes(b"this is no database, but long enough to look at" * 100)
    before = path.read_bytes()
    with pytest.raises(LedgerError) as caught:
        LedgerFile(path)
    assert caught.value.number == Fault.LEDGER_DAMAGED
    assert path.read_bytes() == before


def test_another_programs_database_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "other.sqlite"
    other = sqlite3.connect(path)
    other.execute("PRAGMA user_version = 3")
    other.execute("CREATE TABLE theirs (x)")
    other.close()
    with pytest.raises(LedgerError, match="not a ledger of slabcell"):
        LedgerFile(path)


def test_a_ledger_of_a_newer_version_is_refused(tmp_path):
    path = tmp_path / "ledger.sqlite"
    LedgerFile(path).close()
    newer = sqlite3.connect(path)
    newer.execute("PRAGMA user_version = 99")
    newer.close()
    with pytest.raises(LedgerError, match="install the newer version") as caught:
        LedgerFile(path)
    assert caught.value.number == Fault.LEDGER_NEWER


def test_a_directory_that_is_not_there_is_named(tmp_path):
    with pytest.raises(LedgerError, match="no-such") as caught:
        LedgerFile(tmp_path / "no-such" / "ledger.sqlite")
    assert caught.value.number == Fault.LEDGER_UNWRITABLE


def test_a_full_disk_has_its_own_number(book):
    begin(book)
    pages = book._db.execute("PRAGMA page_count").fetchone()[0]
    book._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(LedgerError, match="disk is full") as caught:
        book.new_session("x" * 100_000)
    assert caught.value.number == Fault.DISK_FULL
    assert not book._db.in_transaction


async def test_the_ledger_works_in_a_thread_of_its_own(tmp_path):
    ledger = await Ledger.open(tmp_path / "ledger.sqlite")
    assert await ledger.run(lambda book: threading.current_thread().name) != threading.current_thread().name
    await ledger.close()
    await ledger.close()
    with pytest.raises(LedgerError, match="is closed"):
        await ledger.run(LedgerFile.last_job)
