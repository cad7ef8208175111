import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from slabcell.calibration import Calibration, CameraIdentity, Lens, TablePlane, save_calibration
from slabcell.cli.locate import locate_command
from slabcell.errors import SlabcellError

pytestmark = pytest.mark.integration

SLOTS = [[(0, 0), (80, 0), (80, 40), (0, 40)], [(0, 0), (60, -10), (85, 35), (20, 50)]]


def picture() -> np.ndarray:
    """Return both slabs at 0.5 mm a pixel, the first as drawn, the second turned by 90 degrees."""
    image = np.full((480, 640), 30, np.uint8)
    for corners in (
        [(60 + 2 * x, 400 - 2 * y) for x, y in SLOTS[0]],
        [(450 - 2 * y, 300 - 2 * x) for x, y in SLOTS[1]],
    ):
        # Counter-clockwise on the table is the mirror of that in pixels; (x, y) -> (u, -v) keeps the shape.
        points = np.array([(u, v) for u, v in corners])
        cv2.fillPoly(image, [points], 180, lineType=cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


@pytest.fixture
def case(tmp_path: Path) -> Path:
    matrix = np.array([[1800.0, 0, 319.5], [0, 1800, 239.5], [0, 0, 1]])
    plane = TablePlane(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 900.0]))
    save_calibration(tmp_path / "c.json", Calibration(CameraIdentity(640, 480), Lens(matrix, np.zeros(5)), plane=plane))
    lines = [",".join(f"{x + 100 * index},{y}" for x, y in slot) for index, slot in enumerate(SLOTS)]
    (tmp_path / "slabs.csv").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "r.toml").write_text('[template]\nfile = "slabs.csv"\nthickness_mm = 0\n', encoding="utf-8")
    cv2.imwrite(str(tmp_path / "a.png"), picture())
    return tmp_path


def run(case: Path, *words: str, code: int = 0) -> str:
    app = typer.Typer()
    app.command()(locate_command)
    result = CliRunner().invoke(
        app, [*words, "--calibration", str(case / "c.json"), "--recipe", str(case / "r.toml")], catch_exceptions=True
    )
    if isinstance(result.exception, SlabcellError):
        # The command's frame prints it and exits with its code.
        assert result.exception.exit_code == code
        return str(result.exception)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == code, result.output
    return result.output if code else result.stdout


def test_one_picture_gives_one_json_object(case: Path):
    document = json.loads(run(case, str(case / "a.png"), "--json"))
    assert document["schema"] == "slabcell.locate/1"
    assert [part["slot"] for part in document["parts"]] == [0, 1]
    assert document["rejected"] == []
    assert document["timing_ms"]["total"] > 0


def test_several_pictures_give_one_line_each(case: Path):
    cv2.imwrite(str(case / "b.png"), np.full((480, 640), 60, np.uint8))
    lines = run(case, str(case), "--json").splitlines()
    assert [len(json.loads(line)["parts"]) for line in lines] == [2, 0]


def test_a_picture_without_slabs_is_a_result_and_not_a_failure(case: Path):
    cv2.imwrite(str(case / "grey.png"), np.full((480, 640), 90, np.uint8))
    assert "0 located" in run(case, str(case / "grey.png"))


def test_a_picture_that_is_all_white_is_refused_by_name(case: Path):
    cv2.imwrite(str(case / "white.png"), np.full((480, 640), 255, np.uint8))
    assert "white.png: the picture cannot be used: over-exposed" in run(case, str(case / "white.png"), code=1)


def test_people_get_a_table(case: Path):
    output = run(case, str(case / "a.png"))
    assert "2 located, 0 refused" in " ".join(output.split())
    assert "Segmentation" in output


def test_an_unusable_picture_is_named_and_the_others_are_still_done(case: Path):
    raw = (case / "a.png").read_bytes()
    (case / "cut.png").write_bytes(raw[: len(raw) // 2])
    output = run(case, str(case / "cut.png"), str(case / "a.png"), "--json", code=1)
    assert "cut.png: is truncated" in output
    assert '"slot": 1' in output


def test_a_picture_of_another_camera_is_refused(case: Path):
    cv2.imwrite(str(case / "small.png"), np.zeros((1, 1), np.uint8))
    output = run(case, str(case / "small.png"), code=78)
    assert "small.png has 1x1 pixels" in output


def test_the_overlay_is_a_picture(case: Path):
    run(case, str(case / "a.png"), "--overlay", str(case / "out.png"))
    drawn = cv2.imread(str(case / "out.png"))
    assert drawn is not None
    assert np.ptp(drawn.astype(int), axis=2).max() > 50


def test_overlays_of_several_pictures_go_into_a_directory(case: Path):
    run(case, str(case / "a.png"), str(case / "a.png"), "--overlay", str(case / "out"))
    assert (case / "out" / "a.overlay.png").is_file()
    message = run(case, str(case / "a.png"), str(case / "a.png"), "--overlay", str(case / "out.png"), code=2)
    assert "name a directory" in message


def test_poses_are_written_as_a_table(case: Path):
    run(case, str(case / "a.png"), "--poses-csv", str(case / "poses.csv"))
    with (case / "poses.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["slot"] for row in rows] == ["0", "1"]
    assert float(rows[0]["pick_a_deg"]) == pytest.approx(0.0, abs=0.2)
    assert float(rows[1]["pick_a_deg"]) == pytest.approx(90.0, abs=0.2)


def test_many_pictures_are_done_by_several_processes_in_order_and_summed_up(case: Path):
    folder = case / "many"
    folder.mkdir()
    for index in range(8):
        (folder / f"{index}.png").write_bytes((case / "a.png").read_bytes())
    (folder / "9.png").write_bytes(b"no picture")
    output = run(case, str(folder), "--overlay", str(case / "drawn"), code=1)
    assert "9 pictures: 16 slabs located, 0 blobs refused, 1 pictures unusable" in " ".join(output.split())
    assert len(list((case / "drawn").glob("*.overlay.png"))) == 8
    lines = [json.loads(line) for line in run(case, str(folder), "--json", code=1).splitlines() if line.startswith("{")]
    assert [Path(line["image"]).name for line in lines] == [f"{index}.png" for index in range(8)]
