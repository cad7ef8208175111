"""`slabcell calibrate` on rendered boards of the simulated cell gives a table that is true to hundredths of a mm."""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell.calibration import load_calibration
from slabcell_drivers.simulation import camera_views, load_scene, plane_views, render_board
from slabcell_drivers.simulation.projection import Projector

pytestmark = pytest.mark.integration

BOARD = ("--board", "checkerboard:12x9:16")
SCENE = Path(__file__).parents[2] / "config" / "scenes" / "dresden.toml"


@pytest.fixture(scope="module")
def scene():
    return load_scene(SCENE)


@pytest.fixture(scope="module")
def boards(scene, tmp_path_factory):
    """Pictures of the board: lens-*.png tilted, table-*.png lying on the table."""
    directory = tmp_path_factory.mktemp("boards")
    for kind, poses in (("lens", camera_views(scene, 3, 9)), ("table", plane_views(scene, 4))):
        for n, pose in enumerate(poses):
            picture = render_board(scene.camera, scene.optics, scene.board, pose, seed=n)
            assert cv2.imwrite(str(directory / f"{kind}-{n}.png"), picture)
    return directory


def calibrate(*arguments):
    return subprocess.run(
        [sys.executable, "-c", "from slabcell.cli import main; main()", "calibrate", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.fixture(scope="module")
def lens(scene, boards):
    out = boards / "lens.json"
    done = calibrate(
        "camera", "--board", scene.board.name, "--serial", "SIM-0001", "--out", out, "--json",
        *sorted(boards.glob("lens-*")),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out, json.loads(done.stdout)


def worst_on_table(scene, calibration, frame, height_mm):
    grid = np.stack(np.meshgrid(np.arange(0.0, 250.0, 10.0), np.arange(0.0, 330.0, 10.0)), axis=-1).reshape(-1, 2)
    solid = np.column_stack([grid, np.full(len(grid), height_mm)]) @ frame.matrix[:3, :3].T + frame.matrix[:3, 3]
    found = calibration.table_from_image(Projector(scene.camera).pixels(solid), height_mm)
    return float(np.linalg.norm(found - grid, axis=1).max())


def test_boards_on_the_table_give_the_table_frame(scene, boards, lens):
    _, report = lens
    assert report["schema"] == "slabcell.calibrate-camera/1"
    assert report["rms_px"] < 0.05
    assert all(view["used"] for view in report["views"])
    out = boards / "cell.json"
    done = calibrate(
        "plane", "--calibration", lens[0], "--board", scene.board.name,
        "--board-thickness-mm", scene.board.thickness_mm,
        "--out", out, *sorted(boards.glob("table-*")),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "table-0.png" in done.stdout
    calibration = load_calibration(out)
    assert calibration.camera.serial == "SIM-0001"
    for height_mm in (0.0, 10.0):
        assert worst_on_table(scene, calibration, scene.table.frame, height_mm) < 0.1


def test_touched_corners_put_the_table_into_the_robots_root(scene, boards, lens, tmp_path):
    first = plane_views(scene, 4)[0].matrix
    lines = ["image,column,row,x,y"]
    for column in (0, 6, 11):
        for row in (0, 4, 8):
            x, y = (first @ (16.0 * column, 16.0 * row, 0.0, 1.0))[:2]
            lines.append(f"table-0.png,{column},{row},{x:.4f},{y:.4f}")
    points = tmp_path / "points.csv"
    points.write_text("\n".join(lines))
    out = tmp_path / "root.json"
    done = calibrate(
        "plane", "--calibration", lens[0], "--board", scene.board.name,
        "--board-thickness-mm", scene.board.thickness_mm,
        "--touch", points, "--out", out, "--json", *sorted(boards.glob("table-*")),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["touch"]["kind"] == "rigid"
    assert report["touch"]["holdout_mm"] < 0.03
    root = load_calibration(out)
    solid = np.array([[200.0, -200.0, 0.0], [300.0, 50.0, 0.0], [250.0, 150.0, 0.0]])
    found = root.table_from_image(Projector(scene.camera).pixels(solid))
    assert np.abs(found - solid[:, :2]).max() < 0.15


@pytest.mark.parametrize(
    ("arguments", "code", "about"),
    [
        (("camera", "--board", "checkerboard:12x9", "--out", "x.json", "lens-0.png"), 2, "is not one of"),
        (("camera", *BOARD, "--out", "x.json", "none.png"), 1, "none.png: cannot be read"),
        (("camera", *BOARD, "--out", "x.json", "lens-0.png"), 78, "at least 4"),
        (("camera", "--board", "checkerboard:5x4:16", "--out", "x.json", "grey.png"), 78, "no picture shows the board"),
        (("plane", "--calibration", "no.json", *BOARD, "--out", "x.json", "table-0.png"), 78, "no.json"),
        (("camera", "lens-0.png"), 2, "--board"),
    ],
)
def test_what_cannot_be_done_is_said_without_a_traceback(boards, tmp_path, arguments, code, about):
    assert cv2.imwrite(str(boards / "grey.png"), np.full((120, 160), 128, np.uint8))
    full = [str(boards / a) if a.endswith((".png", "no.json")) else a for a in arguments]
    done = calibrate(*[str(tmp_path / a) if a == "x.json" else a for a in full])
    assert done.returncode == code, done.stderr
    assert about in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
