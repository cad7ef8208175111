"""The export: a cell's numbers are in the programs, and the programs stay what they are."""

import dataclasses
from pathlib import Path, PurePosixPath

import pytest

from slabcell_drivers.krc.parser import parse
from slabcell_drivers.robot.eki.consistency import check
from slabcell_drivers.robot.eki.export import ExportError, ExportSettings, adapted_programs, export_files
from slabcell_drivers.robot.eki.schema import CHANNEL, Channel
from slabcell_drivers.robot.frame import Frame

pytestmark = pytest.mark.unit
KRL = Path(__file__).parents[3] / "krl"
SHIPPED = {
    str(path.relative_to(KRL)): path.read_text("ascii")
    for path in KRL.rglob("*")
    if path.suffix in {".src", ".dat", ".txt"}
}
SETTINGS = ExportSettings(
    channel=dataclasses.replace(CHANNEL, cell_ip="10.0.0.5", cell_port=54610, robot_ip="10.0.0.7", robot_port=54603),
    tool=Frame(0, 0, 212.5),
    pick_base=Frame(190.25, -290, 1, 1.5),
    place_base=Frame(200, 80, 0, -1),
    tool_number=3,
    pick_base_number=4,
    place_base_number=5,
    vacuum_output=17,
    vacuum_input=18,
    blow_output=19,
    approach_mm=65.5,
    photo_axes_deg=(100, -80, 80, 0, 85.25, 10),
)


def exported(settings=SETTINGS):
    return {str(path): raw.decode("ascii") for path, raw in export_files(SHIPPED, settings).items()}


def test_the_cells_numbers_are_in_the_programs():
    files = exported()
    dat = files["workvisual/KRC/R1/Program/SlabCell/SlabCell.dat"]
    for line in (
        "INT SC_TOOL=3",
        "INT SC_PICKBASE=4",
        "INT SC_PLACEBASE=5",
        "INT SC_OUTVACUUM=17 ;",
        "INT SC_INVACUUM=18 ;",
        "INT SC_OUTBLOW=19 ;",
        "REAL SC_APPROACH=65.5 ;",
        "XSC_PHOTO={A1 100.0,A2 -80.0,A3 80.0,A4 0.0,A5 85.25,A6 10.0,E1 0.0",
    ):
        assert line in dat
    assert "BASE_DATA[4]={X 190.25,Y -290.0,Z 1.0,A 1.5,B 0.0,C 0.0}" in files["controller-data.txt"]
    xml = files["workvisual/Config/User/Common/EthernetKRL/SlabCell.xml"]
    assert "<IP>10.0.0.5</IP>" in xml
    assert "<PORT>54610</PORT>" in xml
    assert files["usb/EthernetKRL/SlabCell.xml"] == xml
    assert files["usb/SlabCell/SlabCell.dat"] == dat


def test_with_the_shipped_values_the_programs_are_the_shipped_ones():
    shipped = {name: text for name, text in SHIPPED.items() if name.endswith((".src", ".dat"))}
    assert adapted_programs(SHIPPED, ExportSettings()) == shipped


def test_the_other_role_brings_its_own_channel():
    files = exported(dataclasses.replace(SETTINGS, robot_connects=False))
    assert 'VT_CH[]="SlabCellServer"' in files["usb/SlabCell/VT.dat"]
    assert "usb/EthernetKRL/SlabCell.xml" not in files
    xml = files["usb/EthernetKRL/SlabCellServer.xml"]
    assert "<TYPE>Client</TYPE>" in xml
    assert "<PORT>54603</PORT>" in xml


@pytest.mark.parametrize("settings", [SETTINGS, dataclasses.replace(SETTINGS, robot_connects=False, prefix="SLC")])
def test_the_exported_files_parse_and_fit_together(settings):
    files = {path: raw for path, raw in export_files(SHIPPED, settings).items() if path.parts[0] == "workvisual"}
    assert check({str(path): raw for path, raw in files.items()}) == []
    for path, raw in files.items():
        if path.suffix in {".src", ".dat"}:
            assert parse(raw, path.name).diagnostics == ()


def test_another_prefix_renames_every_name_and_file():
    files = exported(dataclasses.replace(SETTINGS, prefix="SLC"))
    assert "usb/SlabCell/SLC.src" in files
    assert "usb/SlabCell/VT.src" not in files
    programs = "".join(text for name, text in files.items() if name.startswith("usb/SlabCell/"))
    assert "VT_" not in programs
    assert "DEF SLC()" in programs
    assert "GLOBAL DEF SLC_INIT()" in programs
    # What only contains the letters stays.
    assert "SC_WAITVAC" in programs


def test_lines_end_as_windows_ends_them():
    for name, text in exported().items():
        assert "\r\n" in text, name
        assert "\n" not in text.replace("\r\n", ""), name


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"prefix": "vt"}, "prefix 'vt'"),
        ({"prefix": "TOOLONGNAME"}, "prefix 'TOOLONGNAME'"),
        ({"prefix": "SC"}, "which the programs already have"),
        ({"tool_number": 0}, "tool number 0: must be 1 to 16"),
        ({"vacuum_input": 5000}, "vacuum input 5000: must be 1 to 4096"),
        ({"channel": Channel(cell_port=0)}, "cell port 0"),
        ({"channel": Channel(cell_ip="0.0.0.0")}, "address of the cell PC"),  # noqa: S104 - must be refused
        ({"channel": Channel(cell_ip="127.0.0.1")}, "address of the cell PC"),
        ({"robot_connects": False, "channel": Channel(robot_port=5000)}, "54600 to 54615 only"),
    ],
)
def test_values_that_no_controller_takes_are_refused(change, reason):
    with pytest.raises(ExportError, match=reason):
        export_files(SHIPPED, dataclasses.replace(SETTINGS, **change))


def test_a_value_that_the_programs_no_longer_have_is_an_error_and_not_left_out():
    changed = {**SHIPPED, "SlabCell.dat": SHIPPED["SlabCell.dat"].replace("SC_APPROACH", "SC_HEIGHT")}
    with pytest.raises(ExportError, match="SC_APPROACH is assigned 0 times"):
        export_files(changed, SETTINGS)


def test_paths_stay_below_the_output_folder():
    assert all(not path.is_absolute() and ".." not in path.parts for path in export_files(SHIPPED, SETTINGS))
    assert PurePosixPath("README.txt") in export_files(SHIPPED, SETTINGS)
