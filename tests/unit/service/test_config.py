"""The cell's configuration: what is shipped is valid, and what is wrong is named with its key."""

from importlib.resources import files
from pathlib import Path

import pytest

from slabcell.errors import ConfigurationError
from slabcell.service.config import FrameConfig, load_config
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
