"""The demo: the whole cell lays both patterns, and says so honestly when it does not."""

import json
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.integration, pytest.mark.timeout(300)]

TREE = Path(__file__).resolve().parents[2]
SCENES = sorted(path.stem for path in (TREE / "config" / "scenes").glob("*.toml"))


def demo(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from slabcell.cli import main; main()", "demo", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        env={**os.environ, "NO_COLOR": "1", "COLUMNS": "160"},
    )


def assert_laid(document: dict[str, Any]) -> None:
    assert document["ok"], document["failures"]
    assert document["worst"]["position_mm"] <= 0.3
    assert document["worst"]["angle_deg"] <= 0.3


@pytest.mark.parametrize("scene", SCENES)
def test_the_demo_fills_every_slot_whatever_the_seed(scene: str, tmp_path: Path) -> None:
    seed = random.randrange(2**31)
    print(f"--scene {scene} --seed {seed}")
    done = demo("--scene", scene, "--seed", str(seed), "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert_laid(document)
    assert document["schema"] == "slabcell.demo/1"
    assert document["robot"]["status"] == "done"
    for name in ("before.png", "after.png", "overlay.png", "report.html", "calibration.json", "demo.json"):
        assert (tmp_path / name).stat().st_size > 0
    assert list((tmp_path / "bundles").iterdir())


@pytest.mark.parametrize("camera", ["aravis", "harvesters"])
def test_the_demo_looks_through_a_real_driver(camera: str, tmp_path: Path) -> None:
    done = demo("--camera", camera, "--json", "--out", tmp_path)
    if done.returncode == 69 and os.environ.get("SLABCELL_REQUIRE_CAMERA") != "1":
        pytest.skip(done.stderr)
    assert done.returncode == 0, done.stderr
    assert_laid(json.loads(done.stdout))


def test_over_modbus_the_slabs_lie_where_they_lie_over_eki(tmp_path: Path) -> None:
    laid: dict[str, list[dict[str, float]]] = {}
    for link in ("eki", "modbus-tcp", "modbus-rtu"):
        done = demo("--link", link, "--seed", "4", "--json", "--out", tmp_path / link)
        assert done.returncode == 0, done.stderr
        document = json.loads(done.stdout)
        assert_laid(document)
        assert document["link"] == link
        laid[link] = document["slots"]
    for link in ("modbus-tcp", "modbus-rtu"):
        for over_eki, over_modbus in zip(laid["eki"], laid[link], strict=True):
            for error in ("dx_mm", "dy_mm", "dtheta_deg"):
                assert over_modbus[error] == pytest.approx(over_eki[error], abs=0.001)  # what both links round to


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("scene", SCENES)
def test_twenty_seeds_of_a_scene_are_laid_within_three_tenths(scene: str, tmp_path: Path) -> None:
    for seed in range(20):
        done = demo("--scene", scene, "--seed", str(seed), "--json", "--out", tmp_path)
        assert done.returncode == 0, f"seed {seed}: {done.stdout} {done.stderr}"
        assert_laid(json.loads(done.stdout))


def test_what_a_person_sees_names_stages_slots_and_the_verdict(tmp_path: Path) -> None:
    done = demo("--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "calibrating" in done.stderr
    assert "slot 4 filled" in done.stderr
    assert "every slot is filled" in done.stdout
    assert "total" in done.stdout


def test_a_slab_that_is_missing_leaves_its_slot_free_and_the_exit_code_says_so(tmp_path: Path) -> None:
    scene = (TREE / "config" / "scenes" / "dresden.toml").read_text()
    parts = scene.split("[[slab]]")
    (tmp_path / "poor.toml").write_text("[[slab]]".join(parts[:-1]))
    (tmp_path / "poor-recipe.toml").write_text(
        f'[template]\nfile = "{TREE / "config" / "templates" / "dresden.csv"}"\nthickness_mm = 10.0\n'
    )
    done = demo("--scene", tmp_path / "poor.toml", "--json", "--out", tmp_path / "out")
    assert done.returncode == 1, done.stderr
    document = json.loads(done.stdout)
    assert document["ok"] is False
    assert [slot["filled"] for slot in document["slots"]] == [True, True, True, True, False]
    assert document["failures"] == ["slot 4 is not filled"]


def test_an_unknown_scene_is_a_usage_error_that_names_the_known_ones(tmp_path: Path) -> None:
    done = demo("--scene", "berlin", "--out", tmp_path)
    assert done.returncode == 2
    assert f"choose {', '.join(SCENES)}" in done.stderr


def test_an_output_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = demo("--out", tmp_path / "file" / "out")
    assert done.returncode == 1
    assert "cannot be written: Not a directory; choose another folder" in done.stderr
    assert "Traceback" not in done.stderr
