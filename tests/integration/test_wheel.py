"""The wheel: what is built from the tree works away from the tree."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = [pytest.mark.integration, pytest.mark.timeout(300)]

TREE = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment with the wheel's own files and the locked packages that the tests run on; returns its bin."""
    room = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(room)],
        cwd=TREE,
        check=True,
        capture_output=True,
    )
    (wheel,) = room.glob("*.whl")
    environment = room / "environment"
    venv.create(environment, with_pip=False)
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(environment), "platbase": str(environment)}))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    # The dependencies only: a .pth file does not have the .pth files of the folder it names read, so the editable
    # install of the tree stays out.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return environment / "bin"


def run(installed: Path, cwd: Path, *words: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "VIRTUAL_ENV"))}
    return subprocess.run(
        [str(installed / "python"), "-c", "from slabcell.cli import main; main()", *words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


def test_the_wheel_is_what_runs_and_not_the_tree(installed: Path, tmp_path: Path) -> None:
    found = subprocess.run(
        [str(installed / "python"), "-c", "import slabcell, slabcell_drivers; print(slabcell.__file__)"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert str(TREE / "daemon") not in found.stdout
    assert str(installed.parent) in found.stdout


def test_the_wheel_carries_programs_configuration_and_pages(installed: Path, tmp_path: Path) -> None:
    code = (
        "from importlib.resources import files as f\n"
        "d = f('slabcell') / 'data'\n"
        "for p in ['krl/SlabCell.src', 'krl/SlabCell.xml', 'config/demo.toml', 'config/errors.toml']:\n"
        "    assert (d / p).is_file(), p\n"
        "assert (f('slabcell.hmi') / 'static' / 'report.css').is_file()\n"
    )
    subprocess.run([str(installed / "python"), "-c", code], cwd=tmp_path, check=True, timeout=60)


@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler here")
def test_the_wheel_carries_the_compiled_libraries(installed: Path, tmp_path: Path) -> None:
    code = (
        "from slabcell.vision.kernel import implementation\n"
        "from slabcell_drivers.robot.native import LIBRARY, native_library\n"
        "print(implementation(), native_library() is not None, LIBRARY)\n"
    )
    done = subprocess.run(
        [str(installed / "python"), "-c", code], cwd=tmp_path, check=True, timeout=60, capture_output=True, text=True
    )
    vision, descents, where = done.stdout.split()
    assert (vision, descents) == ("native", "True")
    assert str(installed.parent) in where


def test_the_demo_runs_from_the_wheel(installed: Path, tmp_path: Path) -> None:
    done = run(installed, tmp_path, "demo", "--json", "--out", str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["schema"] == "slabcell.demo/1"
    assert document["ok"] is True
    assert all(slot["filled"] for slot in document["slots"])
