"""`slabcell krl export`: what it writes is checked clean, runs, and says where it goes."""

import asyncio
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from slabcell.cli import main
from slabcell_drivers.krc import SoftwareKrc, read_project
from slabcell_drivers.robot.arm import KR3_R540
from slabcell_drivers.robot.eki import EkiServer
from slabcell_drivers.robot.frame import Frame
from slabcell_drivers.robot.protocol import Answer, RequestType, ResultCode

pytestmark = pytest.mark.integration

CELL = """
recipe = "product.toml"
[camera]
driver = "simulated"
[robot]
tool = { z_mm = 260.0 }
pick_base = { x_mm = 190.0, y_mm = -290.0, a_deg = 1.5 }
place_base = { x_mm = 200.0, y_mm = 80.0, a_deg = -1.0 }
[robot.eki]
host = "10.0.0.5"
port = 54610
[robot.krl]
vacuum_input = 33
photo_axes_deg = [110.0, -85.0, 85.0, 0.0, 90.0, 0.0]
[table]
pick_area = [[0.0, 0.0], [150.0, 0.0], [150.0, 100.0]]
"""


@dataclass
class Done:
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def slabcell(monkeypatch, capsys):
    """The command, in this process."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["slabcell", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        captured = capsys.readouterr()
        return Done(int(ended.value.code or 0), captured.out, captured.err)

    return run


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    return path


async def test_the_exported_programs_check_clean_and_run_under_another_prefix(slabcell, config, tmp_path):
    out = tmp_path / "export"
    done = slabcell("krl", "export", "--config", config, "--out", out, "--prefix", "SLC", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["schema"] == "slabcell.krl-export/1"
    assert all((out / name).is_file() for name in document["files"])
    checked = slabcell("krl", "check", out / "workvisual", "--json")
    assert checked.returncode == 0, checked.stdout
    assert json.loads(checked.stdout)["errors"] == 0
    requests = []

    async def nothing_to_do(request):
        requests.append(request)
        code = ResultCode.JOB_COMPLETE if request.type is RequestType.TRIGGER else ResultCode.OK
        return Answer(1, len(requests), request.sequence, code)

    link = EkiServer("127.0.0.1", 0)
    await link.start(nothing_to_do)
    channel = out / "workvisual/Config/User/Common/EthernetKRL/SlabCell.xml"
    with SoftwareKrc(
        read_project(out / "workvisual/KRC/R1/Program/SlabCell"),
        robot=KR3_R540,
        eki_configs={"SlabCell": channel.read_bytes()},
        eki_addresses={"SlabCell": link.address},
    ) as krc:
        for name, frame in (("TOOL_DATA[1]", Frame(z_mm=260)), ("BASE_DATA[1]", Frame()), ("BASE_DATA[2]", Frame())):
            krc.set_data("", name, frame)
        result = await asyncio.to_thread(krc.run, "SlabCell", max_wall_s=30.0)
        assert (result.status, result.message) == ("done", "")
        assert krc.axes_deg == pytest.approx((110.0, -85.0, 85.0, 0.0, 90.0, 0.0), abs=1e-3)
    await link.stop()
    assert [request.type.name for request in requests] == ["HELLO", "TRIGGER", "BYE"]
    assert requests[1].axes_deg == pytest.approx((110.0, -85.0, 85.0, 0.0, 90.0, 0.0), abs=1e-3)


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "cellpc"])  # noqa: S104 - must be refused
def test_an_address_that_the_robot_cannot_reach_is_refused_with_the_key_to_set(host, slabcell, config, tmp_path):
    config.write_text(CELL.replace("10.0.0.5", host))
    done = slabcell("krl", "export", "--config", config, "--out", tmp_path / "export")
    assert done.returncode == 78
    assert "[robot.krl] cell_ip" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "export").exists()


def test_a_number_that_no_controller_has_is_refused_with_its_limits(slabcell, config, tmp_path):
    config.write_text(CELL.replace("vacuum_input = 33", "vacuum_input = 5000"))
    done = slabcell("krl", "export", "--config", config, "--out", tmp_path / "export")
    assert done.returncode == 78
    assert "vacuum_input = 5000" in done.stderr
    assert "4096" in done.stderr


def test_a_folder_that_cannot_be_written_is_named(slabcell, config, tmp_path):
    (tmp_path / "file").write_text("")
    done = slabcell("krl", "export", "--config", config, "--out", Path(tmp_path, "file", "export"))
    assert done.returncode == 1
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
