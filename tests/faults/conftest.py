"""The parts of other rooms' tests that the faults are made with: the scripted cell, and the daemon with its camera."""

import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

TESTS = Path(__file__).parents[1]


def load(path: str, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, TESTS / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


cell_kit = load("unit/cell/conftest.py", "faults_cell_kit")
daemon_kit = load("integration/daemon/conftest.py", "faults_daemon_kit")

cell = daemon_kit.cell
"""A configured cell whose daemon can be run."""


@pytest.fixture
def make_bench(tmp_path: Path) -> Callable[..., object]:
    """Make a scripted cell whose ledger and bundles lie in a folder of choice."""
    return lambda folder=tmp_path: cell_kit.Bench(folder)


class SmallDisk:
    """A file system of its own, in memory."""

    def __init__(self, folder: Path, size: str) -> None:
        self.folder = folder
        folder.mkdir()
        self._mount("-t", "tmpfs", "-o", f"size={size},mode=0755", "small", str(folder))

    def _mount(self, *words: str) -> None:
        done = subprocess.run(["mount", *words], capture_output=True, text=True, check=False)
        if done.returncode:
            self.folder.rmdir()
            pytest.skip(f"no file system can be mounted here (needs root): {done.stderr.strip()}")

    def fill(self) -> None:
        """Take the last byte."""
        with (self.folder / "filler").open("wb", buffering=0) as stream:
            for size in (1 << 16, 1 << 12, 1):
                try:
                    while True:
                        stream.write(b"x" * size)
                except OSError:
                    continue

    def free(self) -> None:
        (self.folder / "filler").unlink()

    def may_be_written(self, *, yes: bool) -> None:
        subprocess.run(["mount", "-o", f"remount,{'rw' if yes else 'ro'}", str(self.folder)], check=True)

    def close(self) -> None:
        subprocess.run(["umount", "--lazy", str(self.folder)], check=True)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[SmallDisk]:
    if os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    disk = SmallDisk(tmp_path / "disk", "3M")
    yield disk
    disk.close()
