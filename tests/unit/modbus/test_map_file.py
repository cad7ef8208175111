"""A register map that is wrong is refused, and the message says where and why."""

import re
from pathlib import Path

import pytest

from slabcell_drivers.robot.modbus import ModbusMapError, load_map
from slabcell_drivers.robot.modbus.generate import generated_files, main
from slabcell_drivers.robot.modbus.map_file import parse_map
from slabcell_drivers.robot.modbus.register_map import Area

pytestmark = pytest.mark.unit

ROOT = Path(__file__).parents[3]


def test_the_shipped_map_has_four_whole_areas(shipped):
    assert [shipped.span(area) for area in Area] == [(0, 2), (2, 48), (100, 4), (104, 89)]
    assert shipped.layout.unit_id == 1


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("address = 8, name", "address = 7, name", "request.job_id: address 7 lies in request.command"),
        ('{ address = 16, name = "tool"', '{ address = 90, name = "tool"', "leaves a gap behind"),
        ('name = "tool"', 'name = "tol"', "did you mean 'tool'?"),
        ('name = "tool"', 'name = "base"', "request.base: stands 2 times"),
        ("address_offset = 0", "address_offset = -5", "outside 0 to 65535"),
        ("unit_id = 1 ", "unit_id = 248 ", "layout.unit_id = 248"),
        ('word_order = "high-first"', 'word_order = "big"', "layout.word_order = 'big'"),
        ("scale = 1000", "scale = 0", "scale = 0"),
        ("low = -20000", "low = -3000000", "what int32 holds at scale 1000"),
        ("low = -20000, high = 20000", "low = 5, high = 20000", "leaves 0 out"),
        ("low = -20000, high = 20000", "low = 9, high = -9", "must rise"),
        ('type = "int32"', 'type = "float"', "type = 'float'"),
        ("words = 40", "words = 90", "words = 90"),
        ("words = 40, ", "", "a text needs words"),
        ('name = "message", type', 'name = "message", scale = 3, type', "no scale"),
        ("high = 6, ", "high = 6, words = 3, ", "words = 3, but uint16 takes 1"),
        ("part_present = 0", "part_present = 1", "each input needs one of its own"),
        ('name = "sequence_end"', 'name = "sequence_last"', "request.sequence_end: is missing"),
        ("slabcell.modbus_map/1", "slabcell.modbus_map/2", "schema"),
        ("[coils]", "[coils", "is not TOML"),
        ("vacuum = 0", "vacuum = 0\nspare = 1", "coils.spare"),
    ],
)
def test_what_is_wrong_is_named(map_text, old, new, said):
    assert old in map_text
    with pytest.raises(ModbusMapError, match=re.escape(said)):
        parse_map(map_text.replace(old, new, 1))


def test_the_last_registers_of_a_telegram_have_their_order(map_text):
    ends = re.findall(r"    \{ address = (?:45|47|49), .*\n", map_text)
    swapped = map_text.replace(ends[2], "").replace(ends[0], ends[2].replace("49", "45") + ends[0].replace("45", "46"))
    swapped = swapped.replace("{ address = 47, ", "{ address = 48, ")
    with pytest.raises(ModbusMapError, match="must end with sequence_end, check, toggle"):
        parse_map(swapped)


def test_a_missing_or_strange_file_is_named(tmp_path):
    with pytest.raises(ModbusMapError, match=r"absent\.toml: cannot be read"):
        load_map(tmp_path / "absent.toml")
    (tmp_path / "odd.toml").write_bytes(b"\xff")
    with pytest.raises(ModbusMapError, match="not UTF-8"):
        load_map(tmp_path / "odd.toml")
    (tmp_path / "long.toml").write_bytes(b"#" * (1 << 19))
    with pytest.raises(ModbusMapError, match="larger"):
        load_map(tmp_path / "long.toml")


@pytest.mark.parametrize(("path", "text"), generated_files(ROOT).items(), ids=lambda value: getattr(value, "name", ""))
def test_page_and_csv_follow_from_the_map(path, text):
    assert path.read_text("utf-8") == text, "run python -m slabcell_drivers.robot.modbus.generate"


def test_the_csv_of_a_map_of_ones_own_is_one_command(tmp_path, map_text):
    (tmp_path / "mine.toml").write_text(map_text.replace("address_offset = 0", "address_offset = 1000"))
    assert main(["--map", str(tmp_path / "mine.toml"), "--csv", str(tmp_path / "mine.csv")]) == 0
    lines = (tmp_path / "mine.csv").read_text().splitlines()
    assert lines[1].startswith("plc_life,watchdog,0,1000,41001,1,uint16")
    assert main(["--map", str(tmp_path / "absent.toml"), "--csv", "x"]) == 78
