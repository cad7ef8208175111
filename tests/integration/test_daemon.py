"""The daemon as systemd and the robot see it: a process, a real camera driver, the shipped robot programs."""

import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane, save_calibration
from slabcell.service.simulated import SimulatedCell
from slabcell.template import load_template
from slabcell_drivers.camera.aravis_library import AravisLibrary, AravisMissingError
from slabcell_drivers.robot import Frame
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.simulation import load_scene
from slabcell_drivers.simulation.gige import GigeCamera, SensorLimits

pytestmark = [pytest.mark.integration, pytest.mark.timeout(180)]

CONFIG = Path(__file__).parents[2] / "config"
TOOL = Frame(z_mm=260.0)
LIMIT_S = 60.0


@dataclass
class Cell:
    folder: Path
    world: SimulatedCell

    @property
    def config(self) -> Path:
        return self.folder / "cell.toml"


@pytest.fixture
def cell(tmp_path: Path, worker_id: str) -> Iterator[Cell]:
    """A configured cell whose camera is a GigE Vision camera in software that sees the simulated world."""
    try:
        AravisLibrary()
    except AravisMissingError as error:
        if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
            pytest.fail(str(error))
        pytest.skip(str(error))
    world = SimulatedCell(load_scene(CONFIG / "scenes" / "dresden.toml"), 11, KR3_R540, TOOL)
    save_calibration(tmp_path / "calibration.json", true_calibration(world))
    shutil.copytree(CONFIG / "recipes", tmp_path / "recipes")
    shutil.copytree(CONFIG / "templates", tmp_path / "templates")
    host = 1 + int(worker_id.removeprefix("gw")) if worker_id != "master" else 1
    limits = SensorLimits(world.scene.camera.width, world.scene.camera.height)
    with GigeCamera(world.picture, f"127.0.19.{host}", serial=world.scene.camera.serial, limits=limits) as camera:
        text = (CONFIG / "cell.toml").read_text()
        for old, new in (
            ('camera = "192.168.10.20"', f'camera = "{camera.address}"\npacket_size = 8000'),
            ("timeout_s = 2.0", "timeout_s = 20.0"),
            ('host = "192.168.1.10"', 'host = "127.0.0.1"'),
            ("port = 54600", "port = 0"),
            ('name = "reference cell"', f'name = "test"\nstate_directory = "{tmp_path / "state"}"'),
        ):
            assert old in text
            text = text.replace(old, new, 1)
        (tmp_path / "cell.toml").write_text(text)
        yield Cell(tmp_path, world)


def true_calibration(world: SimulatedCell) -> Calibration:
    spec = world.scene.camera
    view = (world.scene.table.frame.inverse() @ spec.frame).matrix
    rotation = view[:3, :3].T
    matrix = np.array([[spec.fx_px, 0.0, spec.cx_px], [0.0, spec.fy_px, spec.cy_px], [0.0, 0.0, 1.0]])
    return Calibration(
        CameraIdentity(spec.width, spec.height, spec.serial),
        Lens(matrix, np.array(spec.distortion)),
        TablePlane(rotation, -rotation @ view[:3, 3]),
    )


@contextmanager
def daemon(config: Path, **environment: str) -> Iterator[tuple[subprocess.Popen[str], tuple[str, int]]]:
    """Run the daemon; gives the process and where the robot may connect."""
    log = (config.parent / "daemon.log").open("a")
    process = subprocess.Popen(
        [sys.executable, "-c", "from slabcell.cli import main; main()", "run", "--config", str(config)],
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
    )
    try:
        assert process.stdout is not None
        assert select.select([process.stdout], [], [], LIMIT_S)[0], "the daemon did not say that it is ready"
        line = process.stdout.readline()
        assert line.startswith("ready for the robot at "), (config.parent / "daemon.log").read_text()
        host, port = line.split()[-1].rsplit(":", 1)
        yield process, (host, int(port))
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        process.wait(LIMIT_S)
        assert process.stdout is not None
        process.stdout.close()
        log.close()


def wait_for_log(config: Path, text: str) -> None:
    log, deadline = config.parent / "daemon.log", time.monotonic() + LIMIT_S
    while text not in log.read_text():
        assert time.monotonic() < deadline, log.read_text()
        select.select([], [], [], 0.02)


def stop(process: subprocess.Popen[str]) -> int:
    process.send_signal(signal.SIGTERM)
    return process.wait(LIMIT_S)


def test_the_robot_lays_the_pattern_through_the_daemon_and_it_ends_in_order(cell: Cell) -> None:
    with daemon(cell.config) as (process, address):
        wait_for_log(cell.config, "camera open")
        with cell.world.controller(address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert (result.status, result.message) == ("done", "")
        assert stop(process) == 0
    slots = load_template(CONFIG / "templates" / "dresden.csv").slots
    placements = cell.world.world.placements([slot.vertices for slot in slots])
    assert all(placement.filled for placement in placements)
    assert max(abs(value) for p in placements for value in (p.dx_mm, p.dy_mm, p.dtheta_deg)) < 0.3
    assert list((cell.folder / "state" / "bundles").iterdir())


def test_the_cell_connects_to_a_robot_that_serves(cell: Cell) -> None:
    text = cell.config.read_text().replace("[robot.eki]", "[robot.krl]\nrobot_connects = false\n\n[robot.eki]")
    cell.config.write_text(text.replace("robot_connects = false", 'robot_connects = false\nrobot_ip = "127.0.0.1"'))
    with daemon(cell.config) as (process, address):
        assert address == ("127.0.0.1", 54_600)
        assert stop(process) == 0


def test_the_supervisor_hears_ready_signs_of_life_and_the_end(cell: Cell) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as supervisor:
        address = str(cell.folder / "notify")
        supervisor.bind(address)
        supervisor.settimeout(LIMIT_S)
        with daemon(cell.config, NOTIFY_SOCKET=address, WATCHDOG_USEC="300000") as (process, _):
            assert supervisor.recv(4096).startswith(b"READY=1")
            assert supervisor.recv(4096) == b"WATCHDOG=1"
            assert supervisor.recv(4096) == b"WATCHDOG=1"
            assert stop(process) == 0
            heard = b""
            while heard != b"STOPPING=1":
                heard = supervisor.recv(4096)


def test_a_second_instance_is_told_to_try_later_and_names_the_first(cell: Cell) -> None:
    with daemon(cell.config) as (process, _):
        second = run(cell.config)
        assert second.returncode == 75
        assert f"process {process.pid}" in second.stderr


def run(config: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from slabcell.cli import main; main()", "run", "--config", str(config)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


def test_an_address_that_is_taken_is_named(cell: Cell) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        cell.config.write_text(cell.config.read_text().replace("port = 0", f"port = {port}"))
        done = run(cell.config)
    assert done.returncode == 69
    assert f"127.0.0.1:{port} cannot be listened on" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_cell_without_its_calibration_does_not_start(cell: Cell) -> None:
    (cell.folder / "calibration.json").unlink()
    done = run(cell.config)
    assert done.returncode == 78
    assert "calibration.json" in done.stderr


def test_another_camera_than_the_calibrated_one_is_refused(cell: Cell) -> None:
    path = cell.folder / "calibration.json"
    path.write_text(path.read_text().replace(cell.world.scene.camera.serial, "ANOTHER"))
    with daemon(cell.config) as (process, address):
        wait_for_log(cell.config, "camera refused")
        wait_for_log(cell.config, '"halted"')
        with cell.world.controller(address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert result.status == "halted"
        assert stop(process) == 0
    assert not cell.world.world.events


def test_a_camera_that_is_not_there_is_waited_for_and_the_robot_is_told(cell: Cell) -> None:
    text = cell.config.read_text()
    lines = ['camera = "127.0.19.250"' if line.startswith("camera = ") else line for line in text.splitlines()]
    cell.config.write_text("\n".join(lines))
    with daemon(cell.config) as (process, address):
        with cell.world.controller(address, seed=1) as controller:
            result = controller.run("SlabCell", max_wall_s=LIMIT_S)
        assert result.status == "halted"
        assert any("1101" in str(message) for message in controller.messages)
        assert stop(process) == 0
    assert not cell.world.world.events
