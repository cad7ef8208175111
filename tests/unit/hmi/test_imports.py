"""The pages are light: neither they nor a verb that reads the configuration load the vision."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.unit

HEAVY = {"scipy", "slabcell.vision", "slabcell.calibration", "slabcell.cell.planning"}


@pytest.mark.parametrize("module", ["slabcell.cli.hmi", "slabcell.service.config_layers"])
def test_it_does_without_the_vision(module: str) -> None:
    program = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=90, check=True)
    assert not HEAVY & set(loaded.stdout.split())
