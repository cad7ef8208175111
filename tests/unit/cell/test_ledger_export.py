"""Does a ledger survive its way out and back, and do damaged files do no harm?"""

import json
import random
import sqlite3
from datetime import UTC, datetime

import pytest
from typer.testing import CliRunner

from slabcell.catalogue import Fault
from slabcell.cell.ledger import LedgerError, LedgerFile
from slabcell.cell.ledger_export import export_document, read_export, restore, set_aside, write_export
from slabcell.cell.records import OfferState, Pair, PlacementRecord
from slabcell.cell.schema import MIGRATIONS, TABLES
from slabcell.cli.ledger import ledger_app
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit


@pytest.fixture
def path(tmp_path):
    """A ledger with one job: one slab placed, one unknown, one planned."""
    path = tmp_path / "ledger.sqlite"
    book = LedgerFile(path)
    job = book.begin_job(7, "squares", "a" * 64, 3)
    pairs = [Pair(slot, Frame(1, 2, 3), Frame(4, 5, 6), 0.9) for slot in range(3)]
    first, second, _ = book.record_cycle(job.job_id, book.new_session("test"), 1, pairs)
    for state in (OfferState.OFFERED, OfferState.ACCEPTED, OfferState.GRASPED, OfferState.PLACED):
        book.move(first.result_id, state)
    for state in (OfferState.OFFERED, OfferState.GRASPED, OfferState.UNKNOWN):
        book.move(second.result_id, state, reason="lost after grasping", fault=Fault.PART_LOST)
    book.record_placements(job.job_id, [PlacementRecord(0, True, float("nan"), 0.1, 0.2, 0.01)])
    book.keep_above(40)
    book.close()
    return path


def export(path):
    book = LedgerFile(path)
    document = export_document(book)
    book.close()
    return document


def test_a_restored_ledger_holds_the_same_and_counts_on(path, tmp_path):
    document = export(path)
    write_export(tmp_path / "export.json", document)
    other = tmp_path / "other.sqlite"
    restore(other, read_export(tmp_path / "export.json"), "export.json")
    again = export(other)
    assert (again["tables"], again["counters"]) == (document["tables"], document["counters"])
    book = LedgerFile(other)
    book.void(1, reason="test")
    (offer,) = book.record_cycle(1, 99, 1, [Pair(2, Frame(), Frame(), 1.0)])
    book.close()
    assert offer.result_id == 41


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.update(schema="other/1"), "no export of a ledger"),
        (lambda d: d.update(version=99), "is of schema 99"),
        (lambda d: d["tables"].pop("offers"), "nothing was restored"),
        (lambda d: d["tables"]["offers"][0].update(state="flying"), "nothing was restored"),
        (lambda d: d["tables"]["offers"][1].update(slot=0), "nothing was restored"),
        (lambda d: d["tables"]["jobs"][0].update({"x); DROP TABLE jobs; --": 1}), "nothing was restored"),
        (lambda d: d["tables"]["cycles"][0].update(job_id=55), "nothing was restored"),
        (lambda d: d["counters"].update(elsewhere=3), "nothing was restored"),
    ],
)
def test_a_damaged_export_restores_nothing(path, tmp_path, change, said):
    document = json.loads(json.dumps(export(path)))
    change(document)
    (tmp_path / "export.json").write_text(json.dumps(document))
    other = tmp_path / "other.sqlite"
    with pytest.raises(LedgerError, match=said):
        restore(other, read_export(tmp_path / "export.json"), "export.json")
    assert not list(tmp_path.glob("other.sqlite*"))


def test_a_ledger_that_is_there_is_never_overwritten(path):
    before = path.read_bytes()
    with pytest.raises(LedgerError, match="exists; set it aside first"):
        restore(path, export(path), "export.json")
    assert path.read_bytes() == before


def test_setting_aside_keeps_the_file(path):
    before = path.read_bytes()
    aside = set_aside(path, now=datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC))
    assert aside.name == "ledger.sqlite.corrupt.20260102T030405Z"
    assert aside.read_bytes() == before
    assert not path.exists()


def test_any_damage_is_named_or_harmless_and_never_another_exception(path, tmp_path):
    raw, chance = path.read_bytes(), random.Random(11)
    for number in range(60):
        damaged = bytearray(raw)
        if chance.random() < 0.3:
            del damaged[chance.randrange(len(damaged)) :]
        else:
            at = chance.randrange(len(damaged))
            damaged[at : at + 64] = chance.randbytes(64)
        other = tmp_path / f"damaged{number}.sqlite"
        other.write_bytes(damaged)
        try:
            book = LedgerFile(other)
            try:
                export_document(book)
                book.new_session("test")
            finally:
                book.close()
        except LedgerError as error:
            assert str(other) in str(error)  # noqa: PT017 - some damage is in bytes that nobody reads


@pytest.mark.parametrize("version", range(len(MIGRATIONS)))
def test_a_ledger_of_every_earlier_version_is_brought_up_to_date(tmp_path, version):
    path = tmp_path / "ledger.sqlite"
    old = sqlite3.connect(path)
    for script in MIGRATIONS[:version]:
        for statement in script:
            old.execute(statement)
    if version:
        old.execute("PRAGMA application_id=1936482658")
        old.execute("INSERT INTO sessions (began_utc, cause) VALUES ('2026', 'kept')")
    old.execute(f"PRAGMA user_version={version}")
    old.commit()
    old.close()
    book = LedgerFile(path)
    assert book._db.execute("PRAGMA user_version").fetchone() == (len(MIGRATIONS),)
    assert {table: book.rows(table) for table in TABLES}
    assert [row["cause"] for row in book.rows("sessions")] == (["kept"] if version else [])
    book.close()
    fresh = LedgerFile(tmp_path / "fresh.sqlite")
    columns = {table: fresh._db.execute(f"PRAGMA table_info({table})").fetchall() for table in TABLES}
    fresh.close()
    book = LedgerFile(path)
    assert {table: book._db.execute(f"PRAGMA table_info({table})").fetchall() for table in TABLES} == columns
    book.close()


def run(*words, code=0, **environment):
    ran = CliRunner().invoke(ledger_app, [str(word) for word in words], env=environment)
    assert ran.exit_code == code, ran.output
    return ran


def test_show_tells_what_became_of_each_result(path):
    document = json.loads(run("show", "--ledger", path, "--json").stdout)
    assert [(row["slot"], row["state"]) for row in document["offers"]] == [
        (0, "placed"),
        (1, "unknown"),
        (2, "planned"),
    ]
    assert "1 of 3 slots are laid" in run("show", STATE_DIRECTORY=str(path.parent)).stdout
    assert "holds no job 5" in str(run("show", "--ledger", path, "--job", 5, code=1).exception)
    assert "no such ledger" in str(run("show", "--ledger", path.with_name("none"), code=1).exception)


def test_a_person_settles_what_is_unknown_and_nothing_else(path):
    assert "result 2, slot 1: placed" in run("resolve", 2, "placed", "--ledger", path).stdout
    for result in (1, 2, 3, 99):
        assert "only an unknown result" in str(run("resolve", result, "failed", "--ledger", path, code=1).exception)


def test_export_and_restore_from_the_command_line(path, tmp_path):
    run("export", tmp_path / "e.json", "--ledger", path)
    before = export(path)["tables"]
    path.write_bytes(b"damaged beyond repair" * 500)
    assert "set aside" in run("restore", tmp_path / "e.json", "--ledger", path).stdout
    assert export(path)["tables"] == before
    assert len(list(tmp_path.glob("ledger.sqlite.corrupt.*"))) == 1


def test_without_a_name_the_ledger_of_the_service_is_meant(tmp_path, monkeypatch):
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setattr("slabcell.cli.ledger.STATE_DIRECTORY", tmp_path)
    missing = run("show", code=1).exception
    assert f"{tmp_path / 'ledger.sqlite'}: there is no such ledger" in str(missing)
    LedgerFile(tmp_path / "ledger.sqlite").close()
    assert "no job yet" in run("show").stdout
