"""Does the doctor find what is wrong, say what to do, and change nothing?"""

import contextlib
import json
import sqlite3
import tomllib
from pathlib import Path

import pytest

from slabcell.cell.ledger import APPLICATION_ID
from slabcell.cell.schema import MIGRATIONS
from slabcell.service.config import CellConfig
from slabcell.service.doctor import Check, Patient, Severity, examine
from slabcell.service.doctor_checks import CHECKS

pytestmark = [pytest.mark.faults, pytest.mark.timeout(180)]

DOCS = Path(__file__).parents[2] / "docs"
CONFIG = Path(__file__).parents[2] / "config"


def findings(cell, code: int) -> dict[int, list[dict]]:
    done = cell.slabcell("doctor", "--config", str(cell.config), "--json")
    assert done.returncode == code, done.stdout + done.stderr
    found: dict[int, list[dict]] = {}
    for item in json.loads(done.stdout)["findings"]:
        found.setdefault(item["number"], []).append(item)
    return found


def worst(found: list[dict]) -> str:
    order = ["ok", "note", "warning", "error"]
    return max((item["severity"] for item in found), key=order.index)


def test_a_running_cell_has_no_error_and_every_check_says_something(cell):
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        found = findings(cell, 0)
        assert daemon.stop() == 0
    assert set(found) == {check.number for check in CHECKS}
    assert [worst(found[number]) for number in (1, 2, 3, 4)] == ["ok"] * 4
    assert "controlled by a client" in found[7][-1]["detail"]
    assert any("the daemon runs" in item["detail"] for item in found[12])


def test_what_is_wrong_is_found_with_its_remedy(cell):
    cell.camera.faults.apply("freeze on")
    (cell.folder / "recipes" / "dresden.toml").write_text("[template]\nfile = 'nowhere.csv'\nthickness_mm = 10\n")
    cell.edit('host = "127.0.0.1"', 'host = "203.0.113.7"')
    state = cell.folder / "state"
    state.mkdir()
    state.chmod(0o777)
    (state / "history.sqlite.corrupt.20260101T000000Z").write_text("")
    calibration = cell.folder / "calibration.json"
    document = json.loads(calibration.read_text())
    calibration.write_text(json.dumps({**document, "created": "2024-01-01T00:00:00+00:00"}))
    before = {path: path.read_bytes() for path in cell.folder.rglob("*") if path.is_file()}
    found = findings(cell, 1)
    assert worst(found[2]) == "error"
    assert "nowhere.csv" in found[2][0]["detail"]
    assert "days old" in found[3][-1]["detail"]
    assert {"chmod o=" in item["remedy"] for item in found[5]} == {True, False}
    assert any("corrupt" in item["detail"] for item in found[5])
    assert worst(found[7]) == "error"
    assert "slabcell camera list" in found[7][-1]["remedy"]
    assert "no address of this PC" in found[10][0]["detail"]
    assert worst(found[12]) == "warning"
    assert {path: path.read_bytes() for path in cell.folder.rglob("*") if path.is_file()} == before


def test_a_cell_without_a_calibration_is_told_where_to_make_one_and_an_activated_one_counts(cell):
    path = cell.folder / "calibration.json"
    state = cell.folder / "state"
    (state / "calibrations").mkdir(parents=True)
    path.rename(state / "calibrations" / "first.json")
    found = findings(cell, 1)[3]
    assert [item["severity"] for item in found] == ["error"]
    assert f"there is no calibration: {path} is not there" in found[0]["detail"]
    assert "page Calibrate" in found[0]["remedy"]
    assert found[0]["docs"] == "how-to/calibrate.md"
    choice = {"schema": "slabcell.active-calibration/1", "calibration": "first"}
    (state / "active-calibration.json").write_text(json.dumps(choice))
    assert worst(findings(cell, 0)[3]) == "ok"


def test_a_calibration_of_another_camera_is_found(cell):
    path = cell.folder / "calibration.json"
    path.write_text(path.read_text().replace(cell.world.scene.camera.serial, "ANOTHER"))
    found = findings(cell, 1)
    assert any("the calibration is of camera ANOTHER" in item["detail"] for item in found[7])


def test_without_a_configuration_the_other_checks_are_still_made(cell):
    cell.config.unlink()
    found = findings(cell, 1)
    assert (worst(found[1]), worst(found[4]), worst(found[9])) == ("error", "ok", worst(found[9]))
    assert found[2][0]["detail"] == "cannot be looked at"
    shown = cell.slabcell("doctor", "--config", str(cell.config))
    assert "✗ D01 configuration" in shown.stdout
    assert "docs/reference/configuration.md" in shown.stdout


def test_an_installed_and_an_edited_unit_are_told_apart(tmp_path):
    unit = tmp_path / "etc/systemd/system/slabcell.service"
    (check,) = [item for item in CHECKS if item.subject == "service"]
    (missing,) = examine(Patient(Path("none"), tmp_path), [check])
    assert (missing.severity, missing.remedy) == (Severity.WARNING, "slabcell install")
    unit.parent.mkdir(parents=True)
    unit.write_text("[Service]\n")
    found = [item.detail for item in examine(Patient(Path("none"), tmp_path), [check])]
    assert any("not the one of this version" in detail for detail in found)
    assert any("not enabled" in detail for detail in found)


@pytest.mark.parametrize(
    ("robot", "severity", "words"),
    [
        ({"eki": {"host": "localhost", "port": 0}}, "warning", "localhost cannot be reached by a robot"),
        ({"eki": {"host": "no.such.name.invalid"}}, "error", "is no address of this PC"),
        ({"link": "modbus-tcp", "modbus": {"port": 0}}, "ok", "127.0.0.1:0 can be listened on"),
        (
            {"link": "modbus-tcp", "modbus": {"host": "203.0.113.7", "peers": ["203.0.113.8"]}},
            "error",
            "[robot.modbus]",
        ),
        ({"link": "modbus-tcp", "modbus": {"role": "client", "host": "plc"}}, "note", "polls the PLC at plc:1502"),
        ({"link": "modbus-rtu", "modbus": {"device": "/dev/no-such-line"}}, "error", "/dev/serial/by-id"),
        ({"link": "modbus-rtu", "modbus": {"device": "/dev/null"}}, "ok", "/dev/null is there"),
    ],
    ids=str,
)
def test_the_robots_end_is_looked_at_by_the_link_that_is_configured(robot, severity, words):
    content = tomllib.loads((CONFIG / "demo.toml").read_text())
    content["robot"] = {**content["robot"], **robot}
    (check,) = [item for item in CHECKS if item.subject == "robot's network"]
    found = list(examine(Patient(Path("none"), config=CellConfig.model_validate(content)), [check]))
    assert found[-1].severity == severity
    assert any(words in f"{item.detail} {item.remedy}" for item in found)


def test_looking_at_a_ledger_of_an_earlier_version_does_not_bring_it_up_to_date(tmp_path):
    old = tmp_path / "ledger.sqlite"
    with contextlib.closing(sqlite3.connect(old)) as database:
        for statement in (*MIGRATIONS[0], f"PRAGMA application_id={APPLICATION_ID}", "PRAGMA user_version=1"):
            database.execute(statement)
    before = old.read_bytes()
    content = {**tomllib.loads((CONFIG / "demo.toml").read_text()), "state_directory": str(tmp_path)}
    (check,) = [item for item in CHECKS if item.subject == "state directory"]
    found = list(examine(Patient(Path("none"), config=CellConfig.model_validate(content)), [check]))
    assert any(f"{old}: in order" in item.detail for item in found)
    assert old.read_bytes() == before


def test_a_small_socket_buffer_is_found(tmp_path):
    (check,) = [item for item in CHECKS if item.subject == "socket buffer"]
    (tmp_path / "proc/sys/net/core").mkdir(parents=True)
    (tmp_path / "proc/sys/net/core/rmem_max").write_text("212992\n")
    (found,) = examine(Patient(Path("none"), tmp_path), [check])
    assert (found.severity, "sysctl --system" in found.remedy) == (Severity.WARNING, True)


def test_a_check_that_fails_itself_does_not_hide_the_others():
    def broken(_):
        raise KeyError("x")

    def fine(_):
        yield Severity.OK, "well", ""

    found = list(examine(Patient(Path("none")), [Check(1, "a", "", broken), Check(2, "b", "", fine)]))
    assert [item.severity for item in found] == [Severity.WARNING, Severity.OK]
    assert "failed itself: KeyError" in found[0].detail


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.subject)
def test_every_check_has_a_page(check):
    assert (DOCS / check.docs).is_file()
