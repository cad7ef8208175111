"""The cell's configuration: what is shipped is valid, and what is wrong is named with its key."""

import json
from importlib.resources import files
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from slabcell.errors import ConfigurationError
from slabcell.service.builder import cell_settings
from slabcell.service.config import FrameConfig
from slabcell.service.config_layers import load_config, load_layers
from slabcell.service.config_reload import RELOADABLE
from slabcell.toml_lines import key_lines
from slabcell_drivers.robot import Frame

pytestmark = pytest.mark.unit

DEMO = files("slabcell") / "data" / "config" / "demo.toml"


def write(folder: Path, old: str, new: str) -> Path:
    text = DEMO.read_text()
    assert old in text
    path = folder / "cell.toml"
    path.write_text(text.replace(old, new))
    return path


def test_the_demos_configuration_is_valid_and_names_its_recipe_relative_to_itself(tmp_path: Path) -> None:
    config = load_config(write(tmp_path, "demo", "demo"))
    assert config.recipe == tmp_path / "recipes" / "dresden.toml"
    assert config.robot.tool.to_frame() == Frame(z_mm=260.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("timeout_s", "timout_s", "unknown key 'camera.timout_s': did you mean 'timeout_s'?"),
        ('model = "kr3r540"', 'model = "kr3"', "robot.model = 'kr3'"),
        ("port = 0", "port = 99999", "less than or equal to 65534"),
        ("z_mm = 260.0", "z_mm = nan", "robot.tool.z_mm"),
        ("[camera]\n", "[camera]\nproducers = {}\n", "camera.producers = {}: Input should be a valid list"),
        ("tool = { z_mm = 260.0 }", "tool = 5", "robot.tool = 5: is a table with keys of its own"),
        ("x_mm = 190.0", "xmm = 190.0", "unknown key 'robot.pick_base.xmm': did you mean 'x_mm'?"),
    ],
)
def test_a_fault_is_named_with_its_key(tmp_path: Path, old: str, new: str, words: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_config(write(tmp_path, old, new))
    assert "cell.toml" in str(caught.value)
    assert words in str(caught.value)


def test_a_frame_survives_the_way_into_the_configuration_and_back() -> None:
    frame = Frame(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert FrameConfig.from_frame(frame).to_frame() == frame


def test_what_is_wrong_is_named_with_file_and_line(tmp_path: Path) -> None:
    path = write(tmp_path, "timeout_s", "timout_s")
    line = next(number for number, text in enumerate(path.read_text().splitlines(), 1) if "timout_s" in text)
    with pytest.raises(ConfigurationError) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}:{line}: unknown key")


def test_drop_ins_win_in_order_and_the_environment_over_all(tmp_path: Path) -> None:
    path = write(tmp_path, "demo", "demo")
    folder = tmp_path / "cell.toml.d"
    folder.mkdir()
    (folder / "20-b.toml").write_text("[camera]\ntimeout_s = 3.0\n")
    (folder / "10-a.toml").write_text("[camera]\ntimeout_s = 2.0\n[verification]\ntolerance_mm = 0.25\n")
    (folder / "30-c.toml.bak").write_text("nonsense")
    loaded = load_layers(path, {"SLABCELL__ROBOT__EKI__HOST": "10.0.0.1", "SLABCELL__NAME": '"a b"', "HOME": "/x"})
    origins = {value.key: (value.value, value.origin) for value in loaded.values}
    assert origins["camera.timeout_s"] == (3.0, f"{folder / '20-b.toml'}:2")
    assert origins["verification.tolerance_mm"] == (0.25, f"{folder / '10-a.toml'}:4")
    assert origins["robot.eki.host"] == ("10.0.0.1", "$SLABCELL__ROBOT__EKI__HOST")
    assert origins["name"] == ("a b", "$SLABCELL__NAME")
    assert origins["planning.attempts_per_slot"] == (3, "default")
    assert [file.name for file in loaded.files] == ["cell.toml", "10-a.toml", "20-b.toml"]


def test_a_fault_in_a_layer_names_the_layer(tmp_path: Path) -> None:
    path = write(tmp_path, "demo", "demo")
    with pytest.raises(ConfigurationError, match=r"\$SLABCELL__CAMERA__TIMEOUT_S: camera.timeout_s = 'soon'"):
        load_layers(path, {"SLABCELL__CAMERA__TIMEOUT_S": "soon"})
    with pytest.raises(ConfigurationError, match=r"\$SLABCELL__CAMRA__GAIN_DB: unknown key 'camra'.*'camera'"):
        load_layers(path, {"SLABCELL__CAMRA__GAIN_DB": "1"})


def test_whatever_file_or_folder_is_named_is_seen_from_where_the_configuration_lies(tmp_path: Path) -> None:
    path = write(tmp_path, "demo", "demo")
    folder = tmp_path / "cell.toml.d"
    folder.mkdir()
    (folder / "paths.toml").write_text(
        'calibration = "c.json"\nstate_directory = "state"\n[camera]\nproducers = ["a.cti"]\nimages = "pictures"\n'
        '[api]\nsocket = "api.sock"\n[robot.modbus]\nmap = "map.toml"\n'
        '[hmi]\nstate_directory = "/var/hmi"\ncertificate = "c.pem"\nprivate_key = "k.pem"\n'
    )
    config = load_config(path)
    assert config.calibration == tmp_path / "c.json"
    assert config.state_directory == tmp_path / "state"
    assert config.camera.producers == [tmp_path / "a.cti"]
    assert config.camera.images == tmp_path / "pictures"
    assert config.api.socket == tmp_path / "api.sock"
    assert config.robot.modbus.map == tmp_path / "map.toml"
    assert config.hmi.state_directory == Path("/var/hmi")
    assert config.hmi.private_key == tmp_path / "k.pem"


@pytest.mark.parametrize("corners", ["[[0, 0], [9, 9], [9, 0], [0, 9]]", "[[0, 0], [9, 9], [18, 18]]"])
def test_an_area_that_encloses_nothing_certain_is_refused(tmp_path: Path, corners: str) -> None:
    path = write(tmp_path, "demo", "demo")
    for name, value in (("PICK_AREA", corners), ("FORBIDDEN", f"[{corners}]")):
        with pytest.raises(ConfigurationError, match="is no simple polygon"):
            load_layers(path, {f"SLABCELL__TABLE__{name}": value})


def test_every_key_that_may_be_reloaded_exists(tmp_path: Path) -> None:
    known = {value.key for value in load_layers(write(tmp_path, "demo", "demo"), {}).values}
    assert set(RELOADABLE) <= known


def test_settings_follow_the_configuration(tmp_path: Path) -> None:
    path = write(tmp_path, "demo", "demo")
    text = path.read_text() + "forbidden = [[[0, 0], [1, 0], [1, 1]]]\n[planning]\nattempts_per_slot = 7\n"
    path.write_text(text + "[verification]\ntolerance_deg = 0.125\n")
    settings = cell_settings(load_config(path))
    assert (len(settings.forbidden), settings.attempts_per_slot, settings.tolerance_deg) == (1, 7, 0.125)


LINES = """
a = 1
[t]            # a table
b.c = 2
d = [
  1, # [x]
  2,
]
e = \'\'\'
[no]
\'\'\'
[[list]]
f = {g = 1, h = [{i = 2}]}
[[list]]
"f g" = 2
[list.inner]
j = 3
"""


def test_keys_are_found_on_their_lines() -> None:
    found = key_lines(LINES)
    assert found[("a",)] == 2
    assert found[("t",)] == 3
    assert found[("t", "b", "c")] == 4
    assert found[("t", "d")] == 5
    assert found[("t", "e")] == 9
    assert found[("list", 0, "f", "h", 0, "i")] == 13
    assert found[("list", 1, "f g")] == 15
    assert found[("list", 1, "inner", "j")] == 17
    assert not any("no" in path for path in found)


_names = st.from_regex(r"[a-z]{1,5}", fullmatch=True)
_documents = st.recursive(
    st.integers() | st.booleans() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_names, inner, max_size=3),
    max_leaves=12,
)


@given(st.dictionaries(_names, _documents, min_size=1, max_size=4))
def test_every_key_of_any_document_has_the_line_that_it_stands_on(document) -> None:
    lines = [f"{name} = {_toml(value)}" for name, value in document.items()]
    found = key_lines("\n".join(lines))
    assert {path[0]: line for path, line in found.items() if len(path) == 1} == {
        name: number for number, name in enumerate(document, 1)
    }


def _toml(value) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_toml(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f") if isinstance(value, str) else str(value)
