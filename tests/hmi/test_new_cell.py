"""A new cell has no calibration: its pages say so, and lead to where the first one is made."""

import importlib.util
import sys
from pathlib import Path

import pytest

from .conftest import PASSWORD, Client, hmi_server

pytestmark = [pytest.mark.hmi, pytest.mark.timeout(300)]

KIT = Path(__file__).parents[1] / "integration" / "daemon" / "conftest.py"
_spec = importlib.util.spec_from_file_location("new_cell_kit", KIT)
assert _spec is not None
assert _spec.loader is not None
_kit = importlib.util.module_from_spec(_spec)
sys.modules["new_cell_kit"] = _kit
_spec.loader.exec_module(_kit)

cell = _kit.cell
"""A configured cell whose daemon can be run, in this file instead of the simulated one."""


def test_every_page_works_without_a_calibration_and_the_doctor_leads_to_the_wizard(cell, tmp_path: Path) -> None:
    (cell.folder / "calibration.json").unlink()
    with cell.daemon() as daemon, hmi_server(cell.socket, tmp_path) as server:
        cell.wait_for_log("camera open")
        client = Client(server.base)
        fields = {"token": server.token, "name": "admin", "password": PASSWORD, "again": PASSWORD}
        assert client.post("/first", fields, HX_Request="").status == 303
        assert "there is no calibration yet" in client.get("/").text
        for path in ("/run", "/tune", "/calibrate", "/calibrate?kind=plane", "/calibrate/history", "/calibrate/drift"):
            assert client.get(path).status == 200, path
        assert "Take 10 more" in client.get("/calibrate/views?kind=camera").text
        findings = client.get("/doctor/findings").text
        assert "there is no calibration: " in findings
        assert 'href="/calibrate"' in findings
        refused = client.post("/calibrate/check", {"board": "checkerboard:12x9:16"})
        assert "no calibration is in use" in refused.said["text"]
        assert daemon.stop() == 0
