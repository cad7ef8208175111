"""The files that follow from the telegram schema are the ones in the repository."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from slabcell_drivers.robot.eki import generate
from slabcell_drivers.robot.eki.generate import generated_files
from slabcell_drivers.robot.eki.krl_constants import splice
from slabcell_drivers.robot.eki.schema import HEARTBEAT_ROOT, ROBOT, VIS

pytestmark = pytest.mark.unit
ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("path", generated_files(ROOT), ids=lambda path: path.name)
def test_the_committed_file_is_the_generated_one(path):
    assert path.read_text("utf-8") == generated_files(ROOT)[path], "run: python -m slabcell_drivers.robot.eki.generate"


def test_a_file_that_differs_is_named_by_the_check_and_mended_by_the_command(tmp_path, capsys):
    (tmp_path / "krl").mkdir()
    for path in (ROOT / "krl").iterdir():
        if path.suffix in {".src", ".dat"}:
            (tmp_path / "krl" / path.name).write_bytes(path.read_bytes())
    assert generate.main(["--check", "--root", str(tmp_path)]) == 1
    assert "SlabCell.xml: differs" in capsys.readouterr().out
    assert not (tmp_path / "krl" / "SlabCell.xml").exists()
    assert generate.main(["--root", str(tmp_path)]) == 0
    assert generate.main(["--check", "--root", str(tmp_path)]) == 0


@pytest.mark.parametrize("name", ["SlabCell.xml", "SlabCellServer.xml"])
def test_the_channel_file_configures_every_element_of_the_schema_once(name):
    document = ElementTree.parse(ROOT / "krl" / name).getroot()  # noqa: S314 - our own file
    received = [element.get("Tag") for element in document.findall("RECEIVE/XML/ELEMENT")]
    sent = [element.get("Tag") for element in document.findall("SEND/XML/ELEMENT")]
    assert sorted(received) == sorted([*(VIS.path(element) for element in VIS.elements), VIS.root, HEARTBEAT_ROOT])
    assert sorted(sent) == sorted(ROBOT.path(element) for element in ROBOT.elements)


def test_only_flags_have_elements_without_a_type():
    document = ElementTree.parse(ROOT / "krl" / "SlabCell.xml").getroot()  # noqa: S314 - our own file
    untyped = [element for element in document.findall("RECEIVE/XML/ELEMENT") if element.get("Type") is None]
    assert {element.get("Tag"): element.get("Set_Flag") for element in untyped} == {
        VIS.root: "998",
        HEARTBEAT_ROOT: "996",
    }


def test_a_file_without_the_generated_fold_is_refused():
    with pytest.raises(ValueError, match="no fold"):
        splice("DEFDAT VT\nENDDAT\n", "x")


def test_the_programs_page_describes_every_global_routine():
    page = (ROOT / "docs" / "reference" / "robot-programs.md").read_text("utf-8")
    for path in (ROOT / "krl").glob("*.src"):
        for name in re.findall(r"^GLOBAL DEF(?:FCT \w+)? (\w+)", path.read_text("ascii"), re.MULTILINE):
            assert f"`{name}(" in page, f"{path.name}: {name} has no comment above it"
