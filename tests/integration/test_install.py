"""`slabcell install`: what it lays runs alone, edited files are kept, and uninstalling takes away just that."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.integration, pytest.mark.timeout(180)]

UNIT = Path(__file__).parents[2] / "systemd" / "slabcell.service"


def slabcell(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "slabcell", *words], capture_output=True, text=True, timeout=120, check=False
    )


def install(root: Path, *words: str) -> dict:
    done = slabcell("install", "--root", str(root), "--json", *words)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def laid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    report = install(root)
    assert "etc/systemd/system/slabcell.service" in report["laid"]
    assert report["kept"] == []
    return root


@pytest.fixture
def root(laid: Path, tmp_path: Path) -> Path:
    """A copy that may be spoilt; the release is the same files."""
    copy = tmp_path / "root"
    shutil.copytree(laid, copy, symlinks=True, copy_function=os.link)
    for path in (copy / "opt/slabcell/installed.json", *(copy / "etc").rglob("*")):  # to be files of their own
        if path.is_file():
            content = path.read_bytes()
            path.unlink()
            path.write_bytes(content)
    return copy


def test_the_release_runs_without_the_tree_it_came_from(laid: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [
            *(str(laid / "opt/slabcell/current/bin/slabcell"), "template", "check"),
            str(laid / "etc/slabcell/templates/dresden.csv"),
        ],
        capture_output=True,
        text=True,
        env={"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
        cwd=tmp_path,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = subprocess.run(
        [str(laid / "opt/slabcell/current/bin/python"), "-c", "import slabcell, cv2; print(slabcell.__file__)"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=True,
    )
    assert Path(found.stdout.strip()).is_relative_to(laid / "opt")


def test_doing_it_again_changes_nothing(root: Path) -> None:
    before = {path: path.lstat().st_mtime_ns for path in root.rglob("*")}
    report = install(root)
    assert (report["laid"], report["kept"], report["removed"]) == ([], [], [])
    assert {path: path.lstat().st_mtime_ns for path in root.rglob("*")} == before


def test_edited_configuration_is_kept_and_what_is_newer_is_laid_beside_it(root: Path) -> None:
    config, unit = root / "etc/slabcell/cell.toml", root / "etc/systemd/system/slabcell.service"
    config.write_text(config.read_text() + "# ours\n")
    unit.write_text("# not for editing: drop-ins are\n")
    report = install(root)
    assert report["kept"] == ["etc/slabcell/cell.toml"]
    assert report["laid"] == ["etc/systemd/system/slabcell.service"]
    assert config.read_text().endswith("# ours\n")

    # As if this version had another cell.toml and another recipe than the one that was installed before.
    manifest = root / "opt/slabcell/installed.json"
    document = json.loads(manifest.read_text())
    recipe = root / "etc/slabcell/recipes/dresden.toml"
    recipe.write_text("# of the version before\n")
    document["files"]["etc/slabcell/recipes/dresden.toml"] = hashlib.sha256(recipe.read_bytes()).hexdigest()
    document["files"]["etc/slabcell/cell.toml"] = "0" * 64
    manifest.write_text(json.dumps(document))
    report = install(root)
    assert report["kept"] == ["etc/slabcell/cell.toml"]
    assert set(report["laid"]) == {"etc/slabcell/cell.toml.new", "etc/slabcell/recipes/dresden.toml"}


def test_a_file_that_a_person_deleted_stays_deleted(root: Path) -> None:
    (root / "etc/slabcell/recipes/stones.toml").unlink()
    report = install(root)
    assert report["laid"] == []
    assert not (root / "etc/slabcell/recipes/stones.toml").exists()


def test_uninstalling_takes_away_what_was_laid_and_leaves_edited_files_and_the_state(root: Path) -> None:
    state = root / "var/lib/slabcell/ledger.sqlite"
    state.parent.mkdir(parents=True)
    state.write_bytes(b"precious")
    config = root / "etc/slabcell/cell.toml"
    config.write_text("# ours\n")
    report = install(root, "--uninstall")
    assert report["kept"] == ["etc/slabcell/cell.toml"]
    left = {str(path.relative_to(root)) for path in root.rglob("*") if not path.is_dir()}
    assert left == {"etc/slabcell/cell.toml", "var/lib/slabcell/ledger.sqlite"}
    again = slabcell("install", "--root", str(root), "--uninstall")
    assert again.returncode == 1
    assert "nothing was installed" in again.stderr


def test_a_folder_that_may_not_be_written_is_named(laid: Path) -> None:
    done = slabcell("install", "--root", "/sys")
    assert done.returncode == 77
    assert "/sys/opt: may not be written" in done.stderr


def test_a_damaged_list_of_what_was_laid_is_not_believed(root: Path) -> None:
    (root / "opt/slabcell/installed.json").write_text('{"schema": "slabcell.install/1", "files": [1]}')
    done = slabcell("install", "--root", str(root))
    assert done.returncode == 1
    assert "installed.json: is damaged" in done.stderr


@pytest.fixture
def analyze() -> str:
    tool = shutil.which("systemd-analyze")
    if tool is None:
        if os.environ.get("SLABCELL_REQUIRE_CAMERA") == "1":
            pytest.fail("systemd-analyze is not installed")
        pytest.skip("systemd-analyze is not installed: Debian's package systemd has it")
    return tool


@pytest.mark.parametrize(("name", "verb"), [("slabcell", "run"), ("slabcell-hmi", "hmi")])
def test_systemd_finds_nothing_wrong_with_the_unit(
    analyze: str, laid: Path, tmp_path: Path, name: str, verb: str
) -> None:
    for source in UNIT.parent.glob("*.service"):
        text = source.read_text()
        (tmp_path / source.name).write_text(text.replace("=/opt/", f"={laid}/opt/"))  # the command has to be there
    unit = tmp_path / f"{name}.service"
    assert f"/opt/slabcell/current/bin/slabcell {verb} " in unit.read_text()
    done = subprocess.run([analyze, "verify", str(unit)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("name", ["slabcell", "slabcell-hmi"])
def test_the_unit_is_hardly_exposed(analyze: str, name: str) -> None:
    done = subprocess.run(
        [analyze, "security", "--offline=true", "--threshold=15", str(UNIT.with_name(f"{name}.service"))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
