"""A configured cell, and its daemon as a process; its camera is one in software that sees the simulated world."""

import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane, save_calibration
from slabcell.service.api.client import ApiClient
from slabcell.service.simulated import SimulatedCell
from slabcell_drivers.camera.aravis_library import AravisLibrary, AravisMissingError
from slabcell_drivers.robot import Frame
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.simulation import load_scene
from slabcell_drivers.simulation.gige import GigeCamera, SensorLimits

CONFIG = Path(__file__).parents[3] / "config"
TOOL = Frame(z_mm=260.0)
LIMIT_S = 60.0
SLABCELL = [sys.executable, "-c", "from slabcell.cli import main; main()"]


@dataclass
class Daemon:
    """A daemon that runs."""

    process: subprocess.Popen[str]
    address: tuple[str, int]
    """Where the robot may connect."""
    client: ApiClient

    def stop(self) -> int:
        """Have it end; return its exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(LIMIT_S)


@dataclass
class ConfiguredCell:
    """A cell's files, and the world that its camera sees."""

    folder: Path
    world: SimulatedCell
    camera: GigeCamera

    @property
    def config(self) -> Path:
        return self.folder / "cell.toml"

    @property
    def socket(self) -> Path:
        return self.folder / "state" / "api.sock"

    def edit(self, old: str, new: str) -> None:
        """Change the configuration."""
        text = self.config.read_text()
        assert old in text
        self.config.write_text(text.replace(old, new, 1))

    def slabcell(self, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run the command as a person does, beside the daemon."""
        return subprocess.run(
            [*SLABCELL, *words],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
            env={**os.environ, "SLABCELL_SOCKET": str(self.socket), "COLUMNS": "200", **environment},
        )

    def run(self) -> subprocess.CompletedProcess[str]:
        """Run a daemon that is to fail."""
        return self.slabcell("run", "--config", str(self.config))

    @contextmanager
    def daemon(
        self, *, limits: Sequence[str] = (), pass_fds: Sequence[int] = (), **environment: str
    ) -> Iterator[Daemon]:
        """Run the daemon, behind the words of ``limits``."""
        log = (self.folder / "daemon.log").open("a")
        process = subprocess.Popen(
            [*limits, *SLABCELL, "run", "--config", str(self.config)],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            pass_fds=tuple(pass_fds),
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
        )
        try:
            assert process.stdout is not None
            assert select.select([process.stdout], [], [], LIMIT_S)[0], "the daemon did not say that it is ready"
            line = process.stdout.readline()
            assert line.startswith("ready for the robot at "), (self.folder / "daemon.log").read_text()
            host, port = line.split()[-1].rsplit(":", 1)
            yield Daemon(process, (host, int(port)), ApiClient(self.socket))
        finally:
            with suppress(ProcessLookupError):
                process.kill()
            process.wait(LIMIT_S)
            assert process.stdout is not None
            process.stdout.close()
            log.close()

    def wait_for_log(self, text: str) -> None:
        """Wait until the daemon has logged this."""
        log, deadline = self.folder / "daemon.log", time.monotonic() + LIMIT_S
        while text not in log.read_text():
            assert time.monotonic() < deadline, log.read_text()
            select.select([], [], [], 0.02)


@pytest.fixture
def cell(tmp_path: Path, worker_id: str) -> Iterator[ConfiguredCell]:
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
        shutil.copy(CONFIG / "cell.toml", tmp_path / "cell.toml")
        configured = ConfiguredCell(tmp_path, world, camera)
        configured.edit('camera = "192.168.10.20"', f'camera = "{camera.address}"\npacket_size = 8000')
        configured.edit("timeout_s = 2.0", "timeout_s = 20.0")
        configured.edit('host = "192.168.1.10"', 'host = "127.0.0.1"')
        configured.edit("port = 54600", "port = 0")
        configured.edit('name = "reference cell"', f'name = "test"\nstate_directory = "{tmp_path / "state"}"')
        yield configured


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
