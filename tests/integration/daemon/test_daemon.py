"""The daemon as systemd and the robot see it: a process, a real camera driver, the shipped robot programs."""

import json
import signal
import socket
from pathlib import Path

import pytest

from slabcell.catalogue import Fault
from slabcell.errors import SlabcellError
from slabcell.template import load_template

pytestmark = [pytest.mark.integration, pytest.mark.timeout(180)]

CONFIG = Path(__file__).parents[3] / "config"
LIMIT_S = 60.0


def test_the_robot_lays_the_pattern_through_the_daemon_and_it_ends_in_order(cell) -> None:
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        with cell.world.controller(daemon.address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert (result.status, result.message) == ("done", "")
        assert daemon.stop() == 0
    slots = load_template(CONFIG / "templates" / "dresden.csv").slots
    placements = cell.world.world.placements([slot.vertices for slot in slots])
    assert all(placement.filled for placement in placements)
    assert max(abs(value) for p in placements for value in (p.dx_mm, p.dy_mm, p.dtheta_deg)) < 0.3
    assert list((cell.folder / "state" / "bundles").iterdir())


def test_the_cell_connects_to_a_robot_that_serves(cell) -> None:
    text = cell.config.read_text().replace("[robot.eki]", "[robot.krl]\nrobot_connects = false\n\n[robot.eki]")
    cell.config.write_text(text.replace("robot_connects = false", 'robot_connects = false\nrobot_ip = "127.0.0.1"'))
    with cell.daemon() as daemon:
        assert daemon.address == ("127.0.0.1", 54_600)
        assert daemon.stop() == 0


def test_the_supervisor_hears_ready_signs_of_life_and_the_end(cell) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        address = str(cell.folder / "notify")
        supervisor.bind(address)
        supervisor.settimeout(LIMIT_S)
        with cell.daemon(NOTIFY_SOCKET=address, WATCHDOG_USEC="300000") as daemon:
            assert supervisor.recv(4096).startswith(b"READY=1")
            assert supervisor.recv(4096) == b"WATCHDOG=1"
            assert supervisor.recv(4096) == b"WATCHDOG=1"
            assert daemon.stop() == 0
            heard = b""
            while heard != b"STOPPING=1":
                heard = supervisor.recv(4096)


def test_a_second_instance_is_told_to_try_later_and_names_the_first(cell) -> None:
    with cell.daemon() as daemon:
        second = cell.run()
        assert second.returncode == 75
        assert f"process {daemon.process.pid}" in second.stderr


def test_a_ledger_is_restored_by_a_whole_export_and_not_under_a_running_daemon(cell, tmp_path) -> None:
    ledger, good, bad = cell.folder / "state" / "ledger.sqlite", tmp_path / "good.json", tmp_path / "bad.json"

    def restore(source):
        return cell.slabcell("ledger", "restore", str(source), "--ledger", str(ledger))

    with cell.daemon() as daemon:
        assert cell.slabcell("ledger", "export", str(good), "--ledger", str(ledger)).returncode == 0
        running = restore(good)
        assert (running.returncode, f"process {daemon.process.pid}" in running.stderr) == (75, True)
        assert daemon.stop() == 0
    before = ledger.read_bytes()
    document = json.loads(good.read_text())
    bad.write_text(json.dumps({**document, "tables": {**document["tables"], "jobs": [{"job_id": "one"}]}}))
    assert "nothing was restored" in restore(bad).stderr
    assert ledger.read_bytes() == before
    done = restore(good)
    assert (done.returncode, "set aside: " in done.stdout) == (0, True)
    assert len(list(ledger.parent.glob("ledger.sqlite.corrupt.*"))) == 1
    assert cell.slabcell("ledger", "show", "--ledger", str(ledger)).returncode == 0


def test_a_state_directory_that_cannot_be_written_is_named(cell) -> None:
    (cell.folder / "state" / "lock").mkdir(parents=True)  # root may write to what is read-only for others
    done = cell.run()
    assert done.returncode == 69
    assert "the daemon has to write into state_directory" in done.stderr
    assert "internal error" not in done.stderr


def test_an_address_that_is_taken_is_named(cell) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        cell.config.write_text(cell.config.read_text().replace("port = 0", f"port = {port}"))
        done = cell.run()
    assert done.returncode == 69
    assert f"127.0.0.1:{port} cannot be listened on" in done.stderr
    assert "Traceback" not in done.stderr


def test_another_camera_than_the_calibrated_one_is_refused(cell) -> None:
    path = cell.folder / "calibration.json"
    path.write_text(path.read_text().replace(cell.world.scene.camera.serial, "ANOTHER"))
    with cell.daemon() as daemon:
        cell.wait_for_log("camera refused")
        cell.wait_for_log('"halted"')
        with cell.world.controller(daemon.address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert result.status == "halted"
        assert daemon.stop() == 0
    assert not cell.world.world.events


def test_a_camera_that_is_not_there_is_waited_for_and_the_robot_is_told(cell) -> None:
    text = cell.config.read_text()
    lines = ['camera = "127.0.19.250"' if line.startswith("camera = ") else line for line in text.splitlines()]
    cell.config.write_text("\n".join(lines))
    with cell.daemon() as daemon:
        with cell.world.controller(daemon.address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert result.status == "halted"
        assert any("1101" in str(message) for message in controller.messages)
        assert daemon.stop() == 0
    assert not cell.world.world.events


def test_a_reload_takes_over_what_may_be_and_names_the_rest(cell) -> None:
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        status = daemon.client.get("/v1/status")
        events = daemon.client.events(kinds=["config"], after=status["event"])
        cell.config.write_text(cell.config.read_text() + "\n[verification]\ntolerance_mm = 0.001\n")
        cell.edit('name = "test"', 'name = "other"')
        daemon.process.send_signal(signal.SIGHUP)
        told = next(events).data
        assert told == {"reloaded": ["verification.tolerance_mm"], "pending": ["name"], "error": None}
        assert daemon.client.get("/v1/status")["pending_reload"] == ["name"]
        cell.edit("tolerance_mm = 0.001", "tolerance_mm = 0.002\nnonsense = 1")
        daemon.process.send_signal(signal.SIGHUP)
        assert "unknown key 'verification.nonsense'" in next(events).data["error"]
        events.close()
        with cell.world.controller(daemon.address, seed=1) as controller:
            assert controller.run("SlabCell", max_wall_s=LIMIT_S).status == "done"
        assert 1901 in [alarm["number"] for alarm in daemon.client.get("/v1/alarms")["alarms"]]


def test_the_configuration_is_checked_and_shown_with_its_origins(cell) -> None:
    right = cell.slabcell("config", "check", "--config", str(cell.config))
    assert "recipe dresden with 5 slots" in right.stdout
    shown = cell.slabcell("config", "show", "--origin", "--config", str(cell.config), SLABCELL__NAME="mine")
    assert "$SLABCELL__NAME" in shown.stdout
    cell.edit("timeout_s = 20.0", "timout_s = 20.0")
    wrong = cell.slabcell("config", "check", "--config", str(cell.config))
    assert wrong.returncode == 78
    assert "did you mean 'timeout_s'?" in wrong.stderr
    assert '"title": "CellConfig"' in cell.slabcell("config", "schema").stdout


def test_a_new_cell_starts_without_a_calibration_and_is_ready_with_its_first_one(cell):
    given = (cell.folder / "calibration.json").read_bytes()
    (cell.folder / "calibration.json").unlink()
    with cell.daemon() as daemon:
        cell.wait_for_log("camera open")
        status = daemon.client.get("/v1/status")
        assert (status["state"], status["held"]) == ("initialized", "calibration")
        assert status["highest_alarm"]["number"] == Fault.CALIBRATION_MISSING
        assert daemon.client.post("/v1/frames/take")["width"] == cell.world.scene.camera.width
        name = daemon.client.send("/v1/calibrations", given, "application/json")["name"]
        with pytest.raises(SlabcellError, match="no calibration is in use") as refused:
            daemon.client.get("/v1/calibration")
        assert refused.value.number == Fault.CALIBRATION_MISSING
        assert "is in use, for restarts too" in daemon.client.post(f"/v1/calibrations/{name}/activate")["detail"]
        status = daemon.client.get("/v1/status")
        assert (status["state"], status["held"], status["alarms"]) == ("ready", None, 0)
        assert daemon.stop() == 0
    with cell.daemon() as daemon:
        assert daemon.client.get("/v1/status")["state"] == "ready"
        assert daemon.stop() == 0
