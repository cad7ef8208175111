"""`slabcell calibrate` on rendered boards of the simulated cell gives a table that is true to hundredths of a mm."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slabcell.calibration import load_calibration
from slabcell_drivers.robot.frame import Frame
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


def test_a_check_holds_on_the_same_table_and_fails_on_a_raised_one(scene, boards, lens, tmp_path):
    out = tmp_path / "cell.json"
    board = ("--board", scene.board.name, "--board-thickness-mm", scene.board.thickness_mm)
    done = calibrate("plane", "--calibration", lens[0], *board, "--out", out, *sorted(boards.glob("table-*")))
    assert done.returncode == 0, done.stderr
    spare = plane_views(scene, 6)[5]
    good, raised = tmp_path / "good.png", tmp_path / "raised.png"
    for path, pose in ((good, spare), (raised, replace(spare, z_mm=spare.z_mm + 4.0))):
        assert cv2.imwrite(str(path), render_board(scene.camera, scene.optics, scene.board, pose, seed=77))
    held = calibrate("check", "--calibration", out, *board, good, "--reference", good)
    assert held.returncode == 0, held.stderr + held.stdout
    assert "the calibration holds" in held.stdout
    moved = calibrate("check", "--calibration", out, *board, raised, "--json")
    assert moved.returncode == 1
    report = json.loads(moved.stdout)
    assert report["ok"] is False
    assert report["board"]["lift_mm"] == pytest.approx(4.0, abs=0.3)
    nothing = calibrate("check", "--calibration", out, good)
    assert nothing.returncode == 2
    assert "--board or --marks" in nothing.stderr


def test_hand_eye_finds_the_camera_that_the_robot_shows_the_board_to(scene, boards, lens, tmp_path):
    on_flange = Frame(-80.0, 60.0, 40.0, 3.0, 2.0, 178.0)
    random = np.random.default_rng(8)
    lines = ["image,X,Y,Z,A,B,C"]
    for n, pose in enumerate(camera_views(scene, 3, 9)):
        flange = (pose @ on_flange.inverse()).as_tuple()
        noisy = np.array(flange) + random.normal(0.0, [0.05] * 3 + [0.01] * 3)
        lines.append(f"lens-{n}.png," + ",".join(f"{v:.5f}" for v in noisy))
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(lines))
    out = tmp_path / "hand-eye.json"
    pictures = sorted(boards.glob("lens-*.png"))
    common = ("hand-eye", "--calibration", lens[0], "--board", scene.board.name, "--poses", poses, "--out", out)
    done = calibrate(*common, "--mount", "eye-to-hand", "--json", *pictures)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert np.abs(np.array(report["camera"][:3]) - scene.camera.frame.as_tuple()[:3]).max() < 1.5
    assert report["holdout_mm"] < 0.5
    assert load_calibration(out).hand_eye.mount == "eye-to-hand"
    shown = calibrate(*common, "--mount", "eye-to-hand", *pictures)
    assert "camera in the base" in shown.stdout
    wrong = calibrate(*common, "--mount", "eye-in-hand", *pictures)
    assert wrong.returncode == 78
    assert "fit --mount eye-to-hand" in wrong.stderr
